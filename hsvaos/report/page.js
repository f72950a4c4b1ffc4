"use strict";
(() => {
  const one = (query, from = document) => from.querySelector(query);
  const all = (query, from = document) => [...from.querySelectorAll(query)];
  const figures = all("figure");
  const source = (key) => one(`figure[data-key="${key}"] img`).src;

  // Finds on or off, everywhere at once.
  one("#show-marks").addEventListener("change", (event) =>
    document.body.classList.toggle("hide-marks", !event.target.checked));

  // Copy a position; file:// pages may lack the clipboard, then the text is selected instead.
  for (const button of all(".copy")) {
    button.addEventListener("click", async () => {
      try {
        await navigator.clipboard.writeText(button.dataset.copy);
        button.textContent = "Copied";
      } catch {
        getSelection().selectAllChildren(one("code", button.parentElement));
        button.textContent = document.execCommand("copy") ? "Copied" : "Selected";
      }
      setTimeout(() => { button.textContent = "Copy"; }, 1600);
    });
  }

  // Before and after: the pictures are those of the panels, so nothing is stored twice.
  const compare = one(".compare");
  if (compare) {
    const stack = one(".stack", compare), slider = one("input", stack);
    const choice = one("select", compare), blink = one(".blink", compare);
    const cut = (share) => stack.style.setProperty("--cut", `${share}%`);
    const show = () => { one(".under", stack).src = source(choice.value); };
    let timer = 0;
    one(".over", stack).src = source("photo");
    show();
    choice.addEventListener("change", show);
    slider.addEventListener("input", () => cut(slider.value));
    blink.addEventListener("click", () => {
      clearInterval(timer);
      const start = blink.getAttribute("aria-pressed") !== "true";
      blink.setAttribute("aria-pressed", start);
      let before = true;
      timer = start ? setInterval(() => { before = !before; cut(before ? 100 : 0); }, 800) : 0;
      cut(start ? 100 : slider.value);
    });
    compare.hidden = false;
  }

  // Enlarge: click or wheel zooms about the pointer, arrows change the picture at the same place.
  const dialog = one("#zoom"), scroller = one(".scroller", dialog), stage = one(".stage", dialog);
  const picture = one("img", stage), marks = one(".marks", stage);
  let current = 0, zoom = 1;
  const layout = (x, y) => {
    const old = stage.getBoundingClientRect();
    const u = old.width ? (x - old.left) / old.width : 0.5;
    const v = old.height ? (y - old.top) / old.height : 0.5;
    const ratio = picture.naturalWidth / picture.naturalHeight || 1;
    const fit = Math.min(scroller.clientWidth, scroller.clientHeight * ratio);
    stage.style.width = `${fit * zoom}px`;
    stage.dataset.zoom = zoom;
    const now = stage.getBoundingClientRect();
    scroller.scrollLeft += now.left + u * now.width - x;
    scroller.scrollTop += now.top + v * now.height - y;
  };
  const middle = () => {
    const box = scroller.getBoundingClientRect();
    return [box.left + box.width / 2, box.top + box.height / 2];
  };
  const open = async (index) => {
    current = (index + figures.length) % figures.length;
    const figure = figures[current];
    picture.src = one("img", figure).src;
    marks.style.display = "view" in figure.dataset ? "" : "none";
    one("#zoom-title").textContent = one("figcaption b", figure).textContent;
    if (!dialog.open) { zoom = 1; dialog.showModal(); }
    await picture.decode().catch(() => {});
    layout(...middle());
  };
  const go = (step) => open(current + step);
  figures.forEach((figure, index) =>
    one(".frame", figure).addEventListener("click", () => open(index)));
  stage.addEventListener("click", (event) => {
    zoom = zoom >= 4 ? 1 : zoom * 2;
    layout(event.clientX, event.clientY);
  });
  scroller.addEventListener("wheel", (event) => {
    if (event.shiftKey) return;
    event.preventDefault();
    zoom = Math.min(8, Math.max(1, zoom * (event.deltaY < 0 ? 1.25 : 0.8)));
    layout(event.clientX, event.clientY);
  }, { passive: false });
  for (const button of all("[data-go]", dialog)) {
    button.addEventListener("click", () => go(Number(button.dataset.go)));
  }
  one("#zoom-close").addEventListener("click", () => dialog.close());
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "ArrowRight") go(1);
    else if (event.key === "ArrowLeft") go(-1);
    else return;
    event.preventDefault();
  });
  addEventListener("resize", () => dialog.open && layout(...middle()));
})();

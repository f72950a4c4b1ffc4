"""An ONNX network, where it runs, and what it says of itself."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

Array = NDArray[Any]

PROVIDERS = {
    "cuda": "CUDAExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
"""Where networks can run, by short name. Chosen in this order: TensorRT builds an engine, for
minutes, for each new size of picture, so it comes before the CPU only."""

PERSON_SCORE = "person_score_threshold"
"""Key in the metadata: the score from which a box counts for a person over all views."""

_DTYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(int64)": np.int64}

_log = logging.getLogger("hsvaos")


@dataclass(frozen=True)
class Port:
    """An input or output of a network.

    Args:
        name: Its name.
        shape: Its sizes; None where they are free.
        dtype: Type of its numbers as ONNX calls it, such as "tensor(float)".
    """

    name: str
    shape: tuple[int | None, ...]
    dtype: str


class Network:
    """An ONNX network in onnxruntime.

    Attributes:
        name: What to call it in messages.
        inputs: Its inputs.
        outputs: Its outputs.
        metadata: What it says of itself, text by key.
        provider: Where it runs: "cuda", "tensorrt", "cpu", or another name of onnxruntime's.
        notes: What the user should know, such as a GPU that could not be used.

    Args:
        model: File of the network, or its content.
        provider: Where to run it: a name in `PROVIDERS` or one of onnxruntime's; by default the
            first of CUDA, TensorRT and CPU that this machine has.
        threads: CPU threads that it uses; by default one a core. With 1 it runs in the thread of
            the caller, under that thread's priority.

    Raises:
        ValueError: If there is no such file, it is no ONNX network, or the provider is not there.
    """

    def __init__(
        self,
        model: str | Path | bytes,
        provider: str | None = None,
        threads: int | None = None,
    ) -> None:
        self.name = "model" if isinstance(model, bytes) else str(model)
        content = model if isinstance(model, bytes) else _read(Path(model))
        wanted = _providers(provider)
        try:
            self._session = _started(content, wanted, threads or 0)
            self.inputs = tuple(_port(one) for one in self._session.get_inputs())
            self.outputs = tuple(_port(one) for one in self._session.get_outputs())
            self.metadata: dict[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)
        except Exception as error:  # onnxruntime's errors have no class in common
            raise ValueError(
                f"{self.name}: expected an ONNX network, onnxruntime says: {_short(error)}"
            ) from None
        used = self._session.get_providers()[0]
        if provider is not None and used != wanted[0]:
            raise ValueError(
                f"provider {provider!r} cannot be started on this machine; onnxruntime offers "
                f"{_short_name(used)}"
            )
        self.provider = _short_name(used)
        self.notes: tuple[str, ...] = ()
        if used != wanted[0]:
            missing = _short_name(wanted[0])
            self.notes = (f"{missing} could not be started, the network runs on {self.provider}",)
            _log.warning(self.notes[0])
        _log.info("%s runs on %s", self.name, self.provider)

    @property
    def picture(self) -> Port:
        """The input that takes pictures, (B, C, H, W).

        Raises:
            ValueError: If there is not exactly one input of four dimensions.
        """
        found = [port for port in self.inputs if len(port.shape) == 4]
        if len(found) != 1:
            shapes = ", ".join(f"{port.name} {list(port.shape)}" for port in self.inputs)
            raise ValueError(f"{self.name}: expected one input (B, C, H, W), got {shapes}")
        return found[0]

    def threshold(self, key: str) -> float | None:
        """Return a score that the metadata name, or None where they do not.

        Args:
            key: Its name.

        Raises:
            ValueError: If it is no number from 0 to 1.
        """
        text = self.metadata.get(key)
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if not 0.0 <= value <= 1.0:
            raise ValueError(
                f"{self.name}: expected {key} from 0 to 1 in the metadata, got {text!r}"
            )
        return value

    def run(self, feeds: Mapping[str, Array]) -> dict[str, Array]:
        """Run the network.

        Args:
            feeds: Input arrays by name; they are converted to the type the input has.

        Returns:
            Outputs by name; floats as float32.

        Raises:
            ValueError: If the network cannot take them.
        """
        types = {port.name: port.dtype for port in self.inputs}
        cast = {
            name: np.ascontiguousarray(value, dtype=_DTYPES.get(types[name]))
            for name, value in feeds.items()
        }
        try:
            results = self._session.run(None, cast)
        except Exception as error:  # onnxruntime's errors have no class in common
            shapes = ", ".join(f"{name} {value.shape}" for name, value in cast.items())
            raise ValueError(f"{self.name}: fails for {shapes}: {_short(error)}") from None
        return {
            port.name: np.asarray(value, np.float32) if port.dtype == "tensor(float16)" else value
            for port, value in zip(self.outputs, results, strict=True)
        }


def _started(content: bytes, providers: list[str], threads: int) -> Any:
    """A session on the first of the providers that can be started."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 4  # what goes wrong is said here, in our words
    try:
        # onnxruntime's own way back to the CPU prints
        return ort.InferenceSession(content, options, providers=providers, enable_fallback=0)
    except Exception:  # onnxruntime's errors have no class in common
        if len(providers) == 1:
            raise
        return _started(content, providers[1:], threads)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise ValueError(f"{path}: no such ONNX file") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read ({error.strerror})") from None


def _providers(asked: str | None) -> list[str]:
    """Names of onnxruntime's providers to start, best first."""
    here = ort.get_available_providers()
    if asked is None:
        return [name for name in PROVIDERS.values() if name in here]
    name = PROVIDERS.get(asked.lower(), asked)
    if name not in here:
        offered = ", ".join(_short_name(one) for one in here)
        raise ValueError(f"provider {asked!r} is not here; this onnxruntime has {offered}")
    return [name]


def _short_name(provider: str) -> str:
    return next((short for short, name in PROVIDERS.items() if name == provider), provider)


def _port(node: Any) -> Port:
    sizes = tuple(size if isinstance(size, int) and size > 0 else None for size in node.shape)
    return Port(node.name, sizes, node.type)


def _short(error: Exception) -> str:
    """First line of what onnxruntime says, without its codes."""
    text = (str(error).strip() or type(error).__name__).splitlines()[0]
    return text.rsplit(" : ", 1)[-1].strip()[:200]

"""Pixels of every supported type as numbers in kernels, and back."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def as_vec3(pixel: wp.vec3ub) -> wp.vec3:
    """Values of a pixel as floats, not scaled."""
    return wp.vec3(float(pixel[0]), float(pixel[1]), float(pixel[2]))


@wp.func
def as_vec3(pixel: wp.vec3us) -> wp.vec3:  # noqa: F811 - Warp overloads by type
    """Values of a pixel as floats, not scaled."""
    return wp.vec3(float(pixel[0]), float(pixel[1]), float(pixel[2]))


@wp.func
def as_vec3(pixel: wp.vec3) -> wp.vec3:  # noqa: F811
    """Values of a pixel as they are."""
    return pixel


@wp.func
def store(value: wp.vec3, like: wp.vec3ub) -> wp.vec3ub:
    """Value rounded and clamped to the type of the second argument."""
    return wp.vec3ub(
        wp.uint8(wp.clamp(value[0] + 0.5, 0.0, 255.0)),
        wp.uint8(wp.clamp(value[1] + 0.5, 0.0, 255.0)),
        wp.uint8(wp.clamp(value[2] + 0.5, 0.0, 255.0)),
    )


@wp.func
def store(value: wp.vec3, like: wp.vec3us) -> wp.vec3us:  # noqa: F811
    """Value rounded and clamped to the type of the second argument."""
    return wp.vec3us(
        wp.uint16(wp.clamp(value[0] + 0.5, 0.0, 65535.0)),
        wp.uint16(wp.clamp(value[1] + 0.5, 0.0, 65535.0)),
        wp.uint16(wp.clamp(value[2] + 0.5, 0.0, 65535.0)),
    )


@wp.func
def store(value: wp.vec3, like: wp.vec3) -> wp.vec3:  # noqa: F811
    """Value as it is."""
    return value


@wp.func
def as_value(pixel: wp.vec3ub) -> wp.vec3:
    """Pixel as what is summed up: a vector for RGB."""
    return as_vec3(pixel)


@wp.func
def as_value(pixel: wp.vec3us) -> wp.vec3:  # noqa: F811 - Warp overloads by type
    """Pixel as what is summed up: a vector for RGB."""
    return as_vec3(pixel)


@wp.func
def as_value(pixel: wp.vec3) -> wp.vec3:  # noqa: F811
    """Pixel as what is summed up: a vector for RGB."""
    return pixel


@wp.func
def as_value(pixel: wp.uint8) -> float:  # noqa: F811
    """Pixel as what is summed up: a number for grey."""
    return float(pixel)


@wp.func
def as_value(pixel: wp.uint16) -> float:  # noqa: F811
    """Pixel as what is summed up: a number for grey."""
    return float(pixel)


@wp.func
def as_value(pixel: float) -> float:  # noqa: F811
    """Pixel as what is summed up: a number for grey."""
    return pixel


@wp.func
def store(value: float, like: wp.uint8) -> wp.uint8:  # noqa: F811
    """Value rounded and clamped to the type of the second argument."""
    return wp.uint8(wp.clamp(value + 0.5, 0.0, 255.0))


@wp.func
def store(value: float, like: wp.uint16) -> wp.uint16:  # noqa: F811
    """Value rounded and clamped to the type of the second argument."""
    return wp.uint16(wp.clamp(value + 0.5, 0.0, 65535.0))


@wp.func
def store(value: float, like: float) -> float:  # noqa: F811
    """Value as it is."""
    return value


@wp.func
def brightness(value: wp.vec3) -> float:
    """Greatest channel of a colour."""
    return wp.max(value[0], wp.max(value[1], value[2]))


@wp.func
def brightness(value: float) -> float:  # noqa: F811
    """Grey level."""
    return value


@wp.func
def is_colour(value: wp.vec3) -> bool:
    """Whether all channels are finite: float images may hold NaN where nothing was measured."""
    return wp.isfinite(value[0]) and wp.isfinite(value[1]) and wp.isfinite(value[2])


@wp.func
def is_colour(value: float) -> bool:  # noqa: F811
    """Whether a grey level is finite."""
    return wp.isfinite(value)


@wp.func
def times_gain(value: wp.vec3, gain: wp.vec3) -> wp.vec3:
    """Colour with a factor on each channel."""
    return wp.cw_mul(value, gain)


@wp.func
def times_gain(value: float, gain: wp.vec3) -> float:  # noqa: F811
    """Grey level with a factor."""
    return value * gain[0]


@wp.func
def as_colour(value: wp.vec3) -> wp.vec3:
    """Colour of a pixel."""
    return value


@wp.func
def as_colour(value: float) -> wp.vec3:  # noqa: F811
    """Grey as a colour of three equal channels."""
    return wp.vec3(value, value, value)

"""Pictures of an animation in files: PNG of one frame, GIF and MP4 of all. No display is needed."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from jaxbody.core.errors import import_extra
from jaxbody.core.progress_lines import working
from jaxbody.core.source_files import writing
from jaxbody.views.scenes.animations import Animation
from jaxbody.views.scenes.colors import rgb
from jaxbody.views.scenes.drawn_frames import BRIGHTEST, DARKEST, Painter

RATES = {".gif": 20, ".mp4": 30}  # frames per second of playing
MOST = 600  # largest number of frames
LOOKED_AT = 6  # number of frames from which the palette of a GIF is chosen
NEARLY_WHITE = 248  # of 255: a color whose three components are at least this becomes white
SWATCH = 16  # height of the strip with shades of one part's color, for the choice of the palette


def save_png(path: Path, painter: Painter, frame: int) -> None:
    """Write one frame as PNG. Error: NOT_SAVED."""
    image = Image.fromarray(painter.picture(frame))
    with writing(path):
        image.save(path, format="PNG", optimize=True)


def save_gif(path: Path, painter: Painter) -> None:
    """Write all frames as a GIF that repeats, with one palette, so that only changes are stored.
    Error: NOT_SAVED."""
    animation = painter.animation
    frames, pauses = _frames(animation, RATES[".gif"])
    images = [Image.fromarray(array) for array in _drawn(painter, frames, path.name)]
    palette = _palette(images[:: max(1, len(images) // LOOKED_AT)], animation)
    small = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    with writing(path):
        small[0].save(
            path,
            format="GIF",
            save_all=True,
            append_images=small[1:],
            duration=pauses,
            loop=0,
            optimize=True,
        )


def _palette(images: list[Any], animation: Animation) -> Any:
    """Return a picture whose palette holds the 256 colors of a GIF: white and colors of these
    pictures, including those of small parts."""
    width, height = images[0].size
    colors = sorted({part.color for part in animation.parts})
    sheet = Image.new("RGB", (width, height * len(images) + SWATCH * len(colors)))
    for k, image in enumerate(images):
        sheet.paste(image, (0, k * height))
    for k, color in enumerate(colors):
        shades = np.clip(np.linspace(DARKEST, BRIGHTEST, width)[:, None] * rgb(color), 0, 255)
        strip = np.round(np.repeat(shades[None], SWATCH, 0)).astype(np.uint8)
        sheet.paste(Image.fromarray(strip), (0, len(images) * height + k * SWATCH))
    reduced = sheet.quantize(256, method=Image.Quantize.MEDIANCUT)
    entries = np.array(reduced.getpalette()).reshape(-1, 3)
    entries[entries.min(1) >= NEARLY_WHITE] = 255
    reduced.putpalette(entries.ravel().tolist())
    return reduced


def save_mp4(path: Path, painter: Painter) -> None:
    """Write all frames as a video in H.264. Errors: MISSING_EXTRA, NOT_SAVED."""
    ffmpeg = import_extra("imageio_ffmpeg", "view")
    rate = RATES[".mp4"]
    frames, pauses = _frames(painter.animation, rate)
    counts = np.diff(np.round(np.cumsum([0, *pauses]) * rate / 1000)).astype(int)
    with writing(path):
        path.open("wb").close()  # else ffmpeg fails with a message of its own
    size = painter.width, painter.height
    with closing(
        ffmpeg.write_frames(str(path), size, fps=rate, macro_block_size=2, quality=7)
    ) as writer:
        writer.send(None)
        for array, count in zip(_drawn(painter, frames, path.name), counts, strict=True):
            for _ in range(count):
                writer.send(np.ascontiguousarray(array))


def _frames(animation: Animation, rate: int) -> tuple[list[int], list[int]]:
    """Return the frames shown at a rate [1/s] and the duration of each [ms], in steps of 10 ms, the
    unit of GIF."""
    if not animation.moves:
        return [0], [1000]
    duration = float(animation.seconds[-1] + animation.pauses[-1])
    count = int(np.clip(round(duration * rate), 2, MOST))
    wanted = np.arange(count) * duration / count
    frames = np.clip(
        np.searchsorted(animation.seconds, wanted + 1e-9, side="right") - 1,
        0,
        len(animation.seconds) - 1,
    )
    shown, first = np.unique(frames, return_index=True)
    ticks = np.maximum(np.diff(np.round(np.append(wanted[first], duration) * 100)), 2)
    return shown.tolist(), [int(10 * tick) for tick in ticks]


def _drawn(painter: Painter, frames: list[int], name: str) -> Iterator[np.ndarray]:
    """Yield the pictures of these frames one after the other, with progress."""
    with working(f"view, {name}") as line:
        for k, i in enumerate(frames):
            line(f"frame {k + 1} of {len(frames)}")
            yield painter.picture(i)

"""Frames of an animation as pictures: meshes in perspective, rasterized with NumPy, names and
trails drawn by matplotlib; and as files, PNG of one frame, GIF and MP4 of all; with no display."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from jaxbody.core.errors import import_extra
from jaxbody.core.progress_lines import working
from jaxbody.core.source_files import writing
from jaxbody.views.scenes.animations import Animation, Camera, DrawnPart, NameLabel
from jaxbody.views.scenes.colors import GRAY, INK, rgb
from jaxbody.views.scenes.name_places import annotate
from jaxbody.views.scenes.shapes import Mesh

MOST = 3_000_000  # largest number of pixels that are tested at once
# pixels in triangles: index of the pixel, 1/depth, and index of the triangle
Fragments = tuple[np.ndarray, np.ndarray, np.ndarray]


class Raster:
    """A picture of height x width pixels, white at first."""

    def __init__(self, height: int, width: int):
        self.height, self.width = height, width
        self.colors = np.full((height * width, 3), 255, np.uint8)
        self.nearest = np.zeros(height * width, np.float32)  # 1/depth
        self.covered = np.zeros(height * width, bool)

    def draw(self, corners: np.ndarray, depths: np.ndarray, colors: np.ndarray) -> None:
        """Draw opaque triangles.

        Args:
            corners: (f, 3, 2), in pixels from the lower left, counterclockwise.
            depths: (f, 3), distances from the camera.
            colors: (f, 3), from 0 to 1.
        """
        pixel, nearness, owner = self._fragments(corners, depths)
        np.maximum.at(self.nearest, pixel, nearness)
        seen = nearness >= self.nearest[pixel]
        self.covered[pixel] = True
        self.colors[pixel[seen]] = np.round(255 * colors).astype(np.uint8)[owner[seen]]

    def blend(
        self, corners: np.ndarray, depths: np.ndarray, colors: np.ndarray, opacity: np.ndarray
    ) -> None:
        """Draw translucent triangles of opacity (f,) over the picture; where several overlap, only
        the nearest one is drawn."""
        pixel, nearness, owner = self._fragments(corners, depths)
        top = self.nearest.copy()
        np.maximum.at(top, pixel, nearness)
        seen = (nearness >= top[pixel]) & (nearness > self.nearest[pixel])
        pixel, owner = pixel[seen], owner[seen]
        self.covered[pixel] = True
        share = opacity[owner, None]
        self.colors[pixel] = np.round(
            share * 255 * colors[owner] + (1 - share) * self.colors[pixel]
        ).astype(np.uint8)

    def picture(self) -> np.ndarray:
        """Return the pixels (height, width, 3), from the top."""
        return self.colors.reshape(self.height, self.width, 3)[::-1]

    def _fragments(self, corners: np.ndarray, depths: np.ndarray) -> Fragments:
        """Return the fragments of triangles: the pixels whose centers are inside them."""
        fragments: list[Fragments] = []
        size = np.array([self.width, self.height])
        low = np.clip(np.floor(corners.min(1)), 0, size).astype(int)
        high = np.clip(np.ceil(corners.max(1)), 0, size).astype(int)
        extent = (high - low).max(1)
        for step in 2 ** np.arange(12):
            rows = np.flatnonzero(
                (extent > step // 2) & (extent <= step) & ((high - low) > 0).all(1)
            )
            fragments += [
                self._inside(part, corners[part], depths[part], low[part], int(step))
                for part in np.array_split(rows, max(1, -(-len(rows) * step**2 // MOST)))
                if len(part)
            ]
        if not fragments:
            return np.zeros(0, int), np.zeros(0, np.float32), np.zeros(0, int)
        pixel, nearness, owner = (np.concatenate(column) for column in zip(*fragments, strict=True))
        return pixel, nearness, owner

    def _inside(
        self, rows: np.ndarray, corners: np.ndarray, depths: np.ndarray, low: np.ndarray, step: int
    ) -> Fragments:
        """Return the fragments of triangles whose boxes begin at `low` (f, 2) and are at most
        `step` wide and high."""
        dy, dx = (x.ravel() for x in np.mgrid[:step, :step])
        x, y = np.stack([dx, dy]).astype(np.float32) + 0.5
        corner = (corners - low[:, None]).astype(np.float32)  # small, so float32 is accurate
        areas = []
        # twice the area of the triangle with these two corners and the center of the pixel
        for one, other in ((1, 2), (2, 0), (0, 1)):
            d, at = corner[:, other] - corner[:, one], corner[:, one]
            areas.append(
                d[:, :1] * y - d[:, 1:] * x + (d[:, 1] * at[:, 0] - d[:, 0] * at[:, 1])[:, None]
            )
        inside = (areas[0] >= 0) & (areas[1] >= 0) & (areas[2] >= 0)
        cut = (low + step > [self.width, self.height]).any(1)
        inside[cut] &= (low[cut, :1] + dx < self.width) & (low[cut, 1:] + dy < self.height)
        k, j = np.nonzero(inside)
        a, b, c = (area[k, j] for area in areas)
        near = (1 / depths).astype(np.float32)[k]  # linear in the picture
        nearness = (a * near[:, 0] + b * near[:, 1] + c * near[:, 2]) / np.maximum(
            a + b + c, np.finfo(np.float32).tiny
        )
        return (
            (low[:, 1] * self.width + low[:, 0])[k] + (dy * self.width + dx)[j],
            nearness,
            rows[k],
        )


LIGHT_FROM = np.array([-0.40, 0.80, 0.45])  # right, up, toward the camera
DARKEST, BRIGHTEST = 0.45, 1.08  # brightness of faces turned away from the light and to it
EDGE, DARK = 0.9, 0.55  # width of the lines along edges [points], and their brightness
FINE = 0.1  # longest edge of a triangle, relative to the size of the model: larger ones are divided
NEAR = 0.05  # least depth, relative to the distance of the camera
OVER = 0.004  # how much nearer lines along edges are drawn, relative to the size
SOLID = 0.75  # least opacity of a part that is drawn as opaque
MARGIN = 0.05  # around the drawing, relative to its longer side; more where names need it
WIDTH, TALLEST = 720, 560  # default width and largest default height of a picture [pixels]
DPI, FINER = 100, 2  # resolution of a picture, and by which factor it is drawn finer
FEW_EDGES = 200  # names keep off the vertices of meshes with more edges, else off every third edge
MOST_NAMED = 7  # largest number of elements whose names are written in a picture
RATIOS = 0.7, 1.9  # least and largest width over height


class Renderer:
    """Draws the parts of an animation, as a camera sees them, into rasters."""

    def __init__(self, animation: Animation, camera: Camera):
        self.animation, self.camera = animation, camera
        fine = FINE * animation.size
        self.meshes = [_divided(part.mesh, fine, part.scale[0]) for part in animation.parts]
        self.edges = [_edges(part.mesh, fine) if part.edged else None for part in animation.parts]

    def raster(self, i: int, low: np.ndarray, width: float, size: tuple[int, int]) -> Raster:
        """Return the raster of all parts in frame i.

        Args:
            i: the frame.
            low: lower left corner of the picture, in the coordinates of the camera.
            width: width of the picture, in these coordinates.
            size: its height and width in pixels.
        """
        self.low, self.fine = low, size[1] / width
        solid, clear = [], []
        for part, mesh, edges in zip(self.animation.parts, self.meshes, self.edges, strict=True):
            pieces = [self._triangles(part, Mesh(part.placed(mesh.vertices, i), mesh.faces))]
            if edges is not None:
                ends, owners = edges
                pieces.append(
                    self._lines(
                        part, part.placed(ends[self._faces_camera(part, i)[owners].any(1)], i)
                    )
                )
            (solid if part.opacity >= SOLID else clear).extend(
                (*piece, np.full(len(piece[0]), part.opacity)) for piece in pieces
            )
        raster = Raster(*size)
        corners, depths, colors, _ = (np.concatenate(column) for column in zip(*solid, strict=True))
        raster.draw(corners, depths, colors)
        if clear:
            raster.blend(*(np.concatenate(column) for column in zip(*clear, strict=True)))
        return raster

    def _faces_camera(self, part: DrawnPart, i: int) -> np.ndarray:
        """Return which triangles of the undivided mesh face the camera."""
        mesh = part.at(i)
        return (
            np.sum((self.camera.position - mesh.vertices[mesh.faces[:, 0]]) * mesh.normals(), -1)
            > 0
        )

    def _triangles(self, part: DrawnPart, mesh: Mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return corners (f, 3, 2) [pixels], depths (f, 3) and colors (f, 3) of the triangles that
        face the camera."""
        flat, depth = self.camera.project(mesh.vertices)
        corners = (self.fine * (flat - self.low))[mesh.faces]
        (ax, ay), (bx, by) = (
            np.moveaxis(corners[:, 1] - corners[:, 0], 1, 0),
            np.moveaxis(corners[:, 2] - corners[:, 0], 1, 0),
        )
        near = NEAR * np.linalg.norm(self.camera.position - self.camera.target)
        seen = (ax * by - ay * bx > 0) & (depth[mesh.faces].min(1) > near)
        n = Mesh(mesh.vertices, mesh.faces[seen]).normals() @ self.camera.axes
        lit = np.clip(0.5 + 0.5 * n @ (LIGHT_FROM / np.linalg.norm(LIGHT_FROM)), 0, 1)
        return (
            corners[seen],
            depth[mesh.faces[seen]] - part.over,
            _colors(part, DARKEST + (BRIGHTEST - DARKEST) * lit),
        )

    def _lines(
        self, part: DrawnPart, edges: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return corners, depths and colors, as `_triangles`, of lines along edges (e, 2, 3), drawn
        as thin rectangles of two triangles."""
        flat, depth = (
            x.reshape(len(edges), 2, *x.shape[1:])
            for x in self.camera.project(edges.reshape(-1, 3))
        )
        ends = self.fine * (flat - self.low)
        d = ends[:, 1] - ends[:, 0]
        length = np.linalg.norm(d, axis=1, keepdims=True)
        side = (
            np.stack([-d[:, 1], d[:, 0]], -1)
            / np.where(length > 0, length, 1.0)
            * 0.5
            * EDGE
            * FINER
            * DPI
            / 72
        )
        a, b, c, e = ends[:, 0] - side, ends[:, 1] - side, ends[:, 1] + side, ends[:, 0] + side
        corners = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, e], 1)])
        depths = (
            np.concatenate([depth[:, [0, 1, 1]], depth[:, [0, 1, 0]]])
            - OVER * self.animation.size
            - part.over
        )
        return corners, depths, _colors(part, np.full(len(corners), DARK))


class Painter:
    """Draws single frames as arrays of pixels (height, width, 3).

    Args:
        animation, camera: the animation and the camera.
        width: width of the pictures in pixels; the height follows from the scene. None takes 720,
            or less for a tall scene.
        names: whether names are written beside bodies, supports and elements.
    """

    def __init__(
        self, animation: Animation, camera: Camera, width: int | None, *, names: bool = True
    ):
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.collections import LineCollection
        from matplotlib.figure import Figure

        self.animation, self.camera = animation, camera
        self.renderer = Renderer(animation, camera)
        flat, _ = camera.project(animation.outline())
        low, high = flat.min(0), flat.max(0)
        sides = high - low + 2 * MARGIN * (high - low).max()
        ratio = float(np.clip(sides[0] / sides[1], *RATIOS))
        width = 2 * round((min(WIDTH, TALLEST * ratio) if width is None else width) / 2)
        self.width, self.height = width, 2 * round(width / ratio / 2)
        figure = Figure(figsize=(width / DPI, self.height / DPI), dpi=DPI * FINER)
        self.canvas = FigureCanvasAgg(figure)
        self.ax = figure.add_axes((0, 0, 1, 1))
        self.ax.set_axis_off()
        self.middle, self.half = (
            (low + high) / 2,
            max(sides[0] / width, sides[1] / self.height) / 2 * np.array([width, self.height]),
        )
        self._widen(1.0)
        self.background: Any = figure.figimage(
            np.full((self.height * FINER, self.width * FINER, 3), 255, np.uint8), zorder=-1
        )
        self.trails: Any = LineCollection([], linewidths=1.6, zorder=3)
        self.ax.add_collection(self.trails, autolim=False)
        self.clock = self.ax.text(
            0.012, 0.015, "", transform=self.ax.transAxes, fontsize=9, color=GRAY, zorder=9
        )
        self.ax.text(
            0.012,
            0.985,
            animation.title,
            transform=self.ax.transAxes,
            fontsize=9,
            color=INK,
            va="top",
            zorder=9,
        )
        for label in animation.labels:
            if label.kind == "title":
                at = camera.project(label.p[:1])[0][0]
                self.ax.text(
                    at[0],
                    at[1],
                    label.text,
                    fontsize=9,
                    color=label.color,
                    ha="center",
                    va="bottom",
                    zorder=9,
                )
        self.names, widest = self._written_names() if names else [], 4 * self.half[0]
        while self.names and (outside := self._outside()) > 0 and self.half[0] < widest:
            for _, text in self.names:
                text.remove()
            self._widen(1.02 + outside)
            self.names = self._written_names()

    def picture(self, i: int) -> np.ndarray:
        """Return the pixels of frame i, drawn with more pixels and then reduced."""
        low, size = self.middle - self.half, self.background.get_array().shape[:2]
        self.background.set_data(self.renderer.raster(i, low, 2 * self.half[0], size).picture())
        trails = self.animation.trails
        drawn = slice(0, i + 1) if self.animation.moves else slice(None)
        self.trails.set_segments([self.camera.project(x.points[drawn])[0] for x in trails])
        self.trails.set_color([trail.color for trail in trails])
        self.clock.set_text(self.animation.clock[i])
        for label, text in self.names:
            text.xy = self.camera.project(label.p[min(i, len(label.p) - 1)][None])[0][0]
        self.canvas.draw()
        return np.asarray(
            Image.fromarray(np.asarray(self.canvas.buffer_rgba())).convert("RGB").reduce(FINER)
        )

    def _widen(self, factor: float) -> None:
        self.half = factor * self.half
        (x, y), (w, h) = self.middle, self.half
        self.ax.set(xlim=(x - w, x + w), ylim=(y - h, y + h))

    def _outside(self) -> float:
        """Return how far names extend beyond the picture, relative to half of its sides."""
        from matplotlib.text import Text

        size = np.array(self.canvas.get_width_height())
        boxes = []
        for _, text in self.names:
            text.get_window_extent()  # places it, with the line that leads to it
            boxes.append(Text.get_window_extent(text).get_points())
        return float(max(np.max(np.abs(box / size - 0.5)) for box in boxes) * 2 - 1)

    def _written_names(self) -> list[tuple[NameLabel, Any]]:
        """Write names beside their parts in the first frame and return them with their texts; they
        keep that offset in all frames."""
        elements = [label for label in self.animation.labels if label.kind == "element"]
        written = {"body", "support", "element" if len(elements) <= MOST_NAMED else ""}
        labels = [label for label in self.animation.labels if label.kind in written]
        return list(zip(labels, write_names(self.ax, self.renderer, labels), strict=True))


def write_names(ax: Any, renderer: Renderer, labels: list[NameLabel]) -> list[Any]:
    """Write names beside their parts in the first frame, off what is drawn, and return the
    texts."""
    known, lines, points, project = len(ax.texts), [], [np.zeros((0, 2))], renderer.camera.project
    for part in renderer.animation.parts:
        if part.framed and not part.below:
            flat, _ = project(part.at(0).vertices)
            edges = part.mesh.edges()[0]
            if len(edges) > FEW_EDGES:
                points.append(flat)
            else:
                lines += [*flat[edges[::3]]]
    places = [project(label.p[:1])[0][0] for label in labels]
    annotate(ax, labels, places, lines, np.concatenate(points))
    return ax.texts[known:]


def _colors(part: DrawnPart, brightness: np.ndarray) -> np.ndarray:
    return np.clip(np.array(rgb(part.color)) / 255 * brightness[:, None], 0, 1)


def _divided(mesh: Mesh, longest: float, scale: np.ndarray) -> Mesh:
    """Return the mesh with its longest edges halved until all are shorter than `longest`, as
    stretched by `scale`."""
    vertices, faces = mesh
    for _ in range(24):
        corners = (vertices * scale)[faces]
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
        long = lengths.max(1) > longest
        if not long.any():
            break
        k = np.argmax(lengths[long], axis=1)
        rolled = np.stack([faces[long][np.arange(len(k)), (k + j) % 3] for j in range(3)], -1)
        middle = len(vertices) + np.arange(len(k))
        vertices = np.concatenate([vertices, (vertices[rolled[:, 0]] + vertices[rolled[:, 1]]) / 2])
        a, b, c = rolled.T
        faces = np.concatenate(
            [faces[~long], np.stack([a, middle, c], -1), np.stack([middle, b, c], -1)]
        )
    return Mesh(vertices, faces)


def _edges(mesh: Mesh, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the sharp edges (e, 2, 3) in pieces shorter than `longest`, and the two triangles of
    each (e, 2)."""
    pairs, owners = mesh.edges()
    ends = mesh.vertices[pairs]
    while len(ends) and (long := np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) > longest).any():
        middle = ends[long].mean(1)
        halves = [np.stack([ends[long][:, 0], middle], 1), np.stack([middle, ends[long][:, 1]], 1)]
        ends, owners = (
            np.concatenate([ends[~long], *halves]),
            np.concatenate([owners[~long], owners[long], owners[long]]),
        )
    return ends, owners


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

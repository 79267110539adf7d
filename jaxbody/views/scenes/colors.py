"""Colors that plots and scenes share."""

# Any four successive colors differ in luminance and thus in gray print; the color-blind can
# distinguish all of them
COLORS = ("#1871bc", "#e0803a", "#8e0523", "#dbb72d", "#09663e", "#8470f1", "#292a6d", "#3db5ad")
GRAY, LIGHT, INK = "#8a8f98", "#dfe4ea", "#2b2f36"


def rgb(color: str) -> tuple[int, ...]:
    """Return red, green and blue of "#rrggbb", from 0 to 255."""
    return tuple(bytes.fromhex(color[1:]))

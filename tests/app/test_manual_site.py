"""The manual as it is built: complete, without a warning, with links that lead somewhere; in a
browser without a request or an error."""

import importlib.util
import inspect
import re
import shutil
import subprocess
import sys
import urllib.parse
from html.parser import HTMLParser
from pathlib import Path

import pytest

import jaxbody as jb
from jaxbody.core.codes import CODES

ROOT = Path(__file__).parents[2]
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
BUILDERS = ("sphinx", "myst_nb", "furo", "latex2mathml", "jupytext")
# hosts that pages may name in links; nothing is loaded from them
EXTERNAL = {"github.com", "www.sphinx-doc.org", "pradyunsg.me"}
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        not all(map(importlib.util.find_spec, BUILDERS)), reason="needs pip install 'jaxbody[docs]'"
    ),
]


class Page(HTMLParser):
    """Links, what the page loads, and the places to which others can link."""

    def __init__(self, path):
        super().__init__()
        self.path, self.links, self.loads, self.places = path, [], [], {""}
        self.text = path.read_text()
        self.feed(self.text)
        self.close()

    def handle_starttag(self, tag, attributes):
        stated = dict(attributes)
        self.places |= {stated[name] for name in ("id", "name") if stated.get(name)}
        if tag == "a" and "href" in stated:
            self.links.append(stated["href"])
        elif tag in ("link", "script", "img", "iframe", "source", "video"):
            loads = stated.get("rel") not in (
                "index",
                "search",
                "next",
                "prev",
                "canonical",
                "author",
                "copyright",
            )
            self.loads += [
                stated[name] for name in ("href", "src", "srcset") if stated.get(name) and loads
            ]


@pytest.fixture(scope="module")
def site():
    """The folder, after the command of the manual; a second build reads only what has changed."""
    command = [sys.executable, "-m", "sphinx", "-W", "-b", "html", "examples/docs", "out/manual"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1500)
    assert done.returncode == 0, done.stderr[-3000:]
    return ROOT / "out" / "manual"


@pytest.fixture(scope="module")
def pages(site):
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


def test_every_public_name_has_a_page_with_its_example(pages, site):
    modules = {name for name in jb.__all__ if inspect.ismodule(getattr(jb, name))}
    names = set(jb.__all__) - modules
    for module in modules:
        inside = getattr(jb, module)
        names |= {
            f"{module}.{name}"
            for name in dir(inside)
            if getattr(inside, name) is not getattr(jb, name, None)
        }
    for name in names:
        place = f"{name}_class" if name != name.lower() and name.lower() in names else name
        page = pages[site / "generated" / "reference" / f"{place}.html"]
        assert "sig-name" in page.text, name
        # the prompt of an example; see the gallery
        assert 'class="gp"' in page.text or name.startswith("plots."), name
    sources = [
        str(path).lower() for path in (ROOT / "examples" / "docs" / "generated").rglob("*.rst")
    ]
    # also where Fit.rst and fit.rst are one file
    assert len(names) > 180 and len(set(sources)) == len(sources)


def test_units_and_shapes_are_in_the_pages(pages, site):
    text = re.sub("<[^>]+>", " ", pages[site / "generated" / "reference" / "Spring.html"].text)
    assert re.search(r"stiffness\s+real number\s+N/m\s+nonnegative unless allow", text)
    text = re.sub("<[^>]+>", "", pages[site / "generated" / "reference" / "linearize.html"].text)
    assert "real (nv, nxi)" in text and "K_geometric" in text


def test_every_code_has_its_place_and_docstrings_link_to_it(pages, site):
    codes = pages[site / "generated" / "codes.html"]
    assert {f"code-{code.lower().replace('_', '-')}" for code in CODES} <= codes.places
    assert (
        "../codes.html#code-singular-k"
        in pages[site / "generated" / "reference" / "equilibrium.html"].links
    )


def test_every_link_leads_somewhere(pages):
    for path, page in pages.items():
        for link in [*page.links, *page.loads]:
            where = urllib.parse.urlsplit(link)
            if where.scheme in ("http", "https", "data", "mailto"):
                continue
            target = (
                (path.parent / urllib.parse.unquote(where.path)).resolve() if where.path else path
            )
            assert target.is_file(), f"{path.name}: {link}"
            if where.fragment and target.suffix == ".html":
                assert urllib.parse.unquote(where.fragment) in pages[target].places, (
                    f"{path.name}: {link}"
                )


def test_nothing_is_loaded_from_elsewhere(pages, site):
    assert len(pages) > 200
    for path, page in pages.items():
        assert [link for link in page.loads if re.match(r"(https?:)?//", link)] == [], path.name
        hosts = {
            urllib.parse.urlsplit(link).netloc for link in page.links if link.startswith("http")
        }
        assert hosts <= EXTERNAL, f"{path.name}: {hosts - EXTERNAL}"
    for style in site.rglob("*.css"):
        assert not re.search(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//", style.read_text()), (
            style.name
        )


def test_the_definition_ran_beside_the_library(pages, site):
    text = re.sub("<[^>]+>", "", pages[site / "theory" / "definition.html"].text)
    for name in ("K", "K_tilde", "excitation"):
        difference = re.search(rf"^{name} +(\d\.\de[-+]\d+)$", text, re.M)
        assert difference and float(difference[1]) < 1e-12, name


def test_the_gallery_shows_every_picture_with_its_script(pages, site):
    gallery = pages[site / "generated" / "gallery.html"]
    pictures = {
        path.name
        for path in (ROOT / "examples" / "images").iterdir()
        if path.suffix in (".png", ".gif")
    }
    assert pictures <= {Path(link).name for link in gallery.loads} and len(pictures) >= 7
    assert gallery.text.count("Made by") == len(pictures)


def browse(address, tmp_path, *options):
    """Chromium says on stderr what a page writes to its console; a request that its policy
    forbids too."""
    command = [
        str(CHROMIUM),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--enable-logging=stderr",
    ]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--virtual-time-budget=15000"]
    return subprocess.run(
        [*command, *options, address], capture_output=True, text=True, timeout=180
    )


PLACES = [
    "index",
    "guide/pictures",
    "generated/reference/equilibrium",
    "theory/paper",
    "generated/gallery",
]


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("width", [400, 1400])
@pytest.mark.parametrize("place", PLACES)
def test_a_browser_shows_a_page_without_a_request_or_an_error(place, width, site, tmp_path):
    import matplotlib.image

    picture = tmp_path / "page.png"
    done = browse(
        (site / f"{place}.html").as_uri(),
        tmp_path,
        f"--window-size={width},1200",
        f"--screenshot={picture}",
    )
    assert "CONSOLE" not in done.stderr
    image = matplotlib.image.imread(picture)
    assert image.shape[:2] == (1200, width) and image[..., :3].std() > 0.05  # not blank


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_a_request_would_be_seen(site, tmp_path):
    """In a copy of the start page beside it, which asks for a picture of another server."""
    asks = site / "asks_elsewhere.html"
    try:
        asks.write_text(
            (site / "index.html")
            .read_text()
            .replace("</article>", "<img src='https://example.org/a.png' alt=''></article>")
        )
        assert (
            "CONSOLE"
            in browse(asks.as_uri(), tmp_path, f"--screenshot={tmp_path / 'a.png'}").stderr
        )
    finally:
        asks.unlink()


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_the_search_works_from_a_file(site, tmp_path):
    done = browse((site / "search.html").as_uri() + "?q=linearize", tmp_path, "--dump-dom")
    found = re.findall(
        r'<a href="([^"]+)"[^>]*>([^<]*)</a>',
        done.stdout[done.stdout.index('id="search-results"') :],
    )
    assert "CONSOLE" not in done.stderr
    assert any(link.startswith("generated/reference/linearize.html") for link, _ in found)
    done = browse((site / "search.html").as_uri() + "?q=qqzzxx", tmp_path, "--dump-dom")
    assert "did not match any documents" in done.stdout

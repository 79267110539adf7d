"""Settings of the manual: python -m sphinx -W -b html examples/docs out/manual"""

import hashlib
import inspect
import sys
from pathlib import Path

from docutils import nodes

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

from builders import docstrings, formulas, galleries, references

import jaxbody

project, author, copyright = "jaxbody", "The jaxbody authors", "The jaxbody authors"
release = version = jaxbody.__version__
extensions = ["sphinx.ext.autodoc", "myst_nb"]
exclude_patterns = ["builders", "extending/*.py"]
default_role = "code"
smartquotes = False  # quotes are those of code
html_theme, html_title = "furo", f"jaxbody {release}"
html_copy_source = html_show_sourcelink = html_show_sphinx = False
html_show_search_summary = False  # it would read pages again, which browsers refuse for files
html_static_path, html_css_files = ["static"], ["manual.css"]
html_theme_options = {"navigation_with_keys": True}
html_math_renderer = "mathml"
autodoc_typehints = "signature"
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 100
toc_object_entries = False
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_inline"]
myst_heading_anchors = 3
nb_execution_mode = "force"
# notebooks run in tests; here their results are shown where there are any
nb_execution_excludepatterns = ["*.ipynb"]
nb_execution_timeout = 300
nb_execution_raise_on_error = nb_merge_streams = True
nb_ipywidgets_js = {}  # nothing comes from other servers
linkcheck_timeout, linkcheck_retries, linkcheck_workers = 20, 2, 4
linkcheck_ignore = [  # by the command in development.md, which needs a network
    # pages of the manual and files beside it: the tests of the built pages follow these
    r"^(?!https?:)",
    r"https?://(localhost|127\.0\.0\.1)",
]
linkcheck_allowed_redirects = {r"https://(dx\.)?doi\.org/.*": r".*"}
suppress_warnings = ["mystnb.unknown_mime_type"]


def convert_docstring(app, what, name, found, options, lines):
    lines[:] = docstrings.to_rst(inspect.cleandoc("\n".join(lines)))


def shorten_signature(app, what, name, found, options, signature, result):
    """Arrays as the code writes them. Classes of results are made by functions: their fields stand
    in a table, not in a signature."""
    if what == "class" and name.removeprefix("jaxbody.").split(".")[0] not in jaxbody.__all__:
        return "", None
    return tuple(text and references.short_types(text) for text in (signature, result))


def write_pages(app):
    references.write(HERE / "generated", references.pages() | galleries.pages(HERE.parents[1]))


def remove_old_pages(app, error):
    """Pages of names that no longer exist."""
    for path in (Path(app.outdir) / "generated").rglob("*.html"):
        if path.relative_to(app.outdir).with_suffix("").as_posix() not in app.env.all_docs:
            path.unlink()


def forbid_requests(app, page, template, context, doctree):
    """A policy in each page by which browsers refuse to ask other servers for anything."""
    policy = "default-src 'self' file: data: 'unsafe-inline'"
    context["metatags"] = (
        context.get("metatags", "")
        + f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
    )


def link_names(app, doctree, page):
    """Code that is a public name links to its page, except where it names an argument or
    a field."""
    for literal in doctree.findall(nodes.literal):
        name = literal.astext().removeprefix("jb.").removesuffix("()")
        target, parents = f"generated/reference/{references.place(name)}", set()
        node = literal.parent
        while node is not None:
            parents.add(type(node))
            node = node.parent
        if (
            target in app.env.all_docs
            and target != page
            and not parents & {nodes.reference, nodes.term, nodes.title, nodes.entry}
        ):
            link = nodes.reference(
                "", "", refuri=app.builder.get_relative_uri(page, target), internal=True
            )
            literal.parent.replace(literal, link)
            link += literal


def setup(app):
    sources = [
        HERE / "conf.py",
        *(HERE / "builders").glob("*.py"),
        *Path(jaxbody.__file__).parent.rglob("*.py"),
    ]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()
    # all is built anew where the package or its rendering changes
    app.add_config_value("sources_digest", digest, "env")
    app.connect("autodoc-process-docstring", convert_docstring)
    app.connect("build-finished", remove_old_pages)
    app.connect("html-page-context", forbid_requests)
    app.connect("doctree-resolved", link_names)
    app.connect("autodoc-process-signature", shorten_signature)
    app.connect("builder-inited", write_pages)
    app.add_html_math_renderer("mathml", (formulas.inline, None), (formulas.block, None))

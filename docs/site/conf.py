"""Configuration of the documentation site; `tools/build_docs` builds it.

The root of the repository is the source folder, so that every link between pages works in the site as it works in the
repository, and README.md is the start page.
"""

import atexit
import logging
import os
import shutil
import tempfile
from dataclasses import is_dataclass
from importlib.metadata import version as version_of
from pathlib import Path

from docutils import nodes
from sphinx import addnodes

ROOT = Path(__file__).resolve().parents[2]
CONTENTS = {
    "Tutorials": ["docs/tutorials/*.md", "docs/tutorials/notebooks/*.md"],
    "Guides": [
        "docs/safety.md", "docs/troubleshooting.md", "docs/settings.md", "docs/controllers.md",
        "docs/populations.md", "docs/sweeps.md", "docs/benchmark.md",
        "docs/sessions.md", "docs/interfaces.md", "docs/boards.md", "docs/real-time.md", "docs/hazards.md",
        "docs/watchdog.md", "docs/open-board.md", "docs/parity.md",
    ],
    "Course": ["docs/course/*.md"],
    "Reference": ["docs/reference.md", "docs/api/*.md", "firmware_protocol/PROTOCOL.md"],
    "Contribute": [
        "CONTRIBUTING.md", "docs/architecture.md", "docs/how-to/*.md", "docs/decisions/*.md", "docs/facts/*.md",
        "tests/**/*.md",
    ],
    "Project": ["*.md", "docs/*.md"],
}  # fmt: skip
"""Patterns of the pages below each heading of the sidebar. A page stands where it is named first; beside a README.md,
below that."""

project = "inteco-abs"
version = release = version_of("inteco-abs")
root_doc = "README"
extensions = ["myst_nb", "sphinx.ext.autodoc"]  # myst_nb reads Markdown by myst_parser
include_patterns = ["**.md", "docs/tutorials/notebooks/*.ipynb"]
exclude_patterns = [".*", "build", "dist", "sessions", "**/node_modules", "docs/source"]
myst_heading_anchors = 6

nb_execution_mode = "off" if os.environ.get("NOTEBOOKS") == "unexecuted" else "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_execution_show_tb = True
nb_merge_streams = True
logging.getLogger("traitlets").setLevel(logging.WARNING)  # each notebook's start

# kernels without the user's own profile; the warning that each writes about its connection concerns other computers
PROFILE = Path(tempfile.mkdtemp(prefix="inteco-abs-site-"))
atexit.register(shutil.rmtree, PROFILE, ignore_errors=True)
(PROFILE / "profile_default").mkdir()
(PROFILE / "profile_default/ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 40\n", encoding="utf-8")
os.environ |= {"IPYTHONDIR": str(PROFILE), "PYDEVD_DISABLE_FILE_VALIDATION": "1"}

suppress_warnings = ["misc.highlighting_failure"]  # what commands print is in no language

default_role = "py:obj"  # `name` in docstrings: a link where the name is documented, else code
add_module_names = False
autodoc_default_options = {"members": True, "undoc-members": True, "exclude-members": "__init__, __new__"}
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 88

html_theme = "furo"
html_title = "inteco-abs"
html_copy_source = False
html_show_copyright = False
html_extra_path = ["index.html"]
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_show_search_summary = False  # a browser reads no other page for it when the site is opened as files


def toctree(pages, caption=""):
    """A part of the sidebar."""
    return "\n".join(["```{toctree}", ":hidden:", f":caption: {caption}" if caption else "", "", *pages, "```"])


def contents():
    """The sidebar: each page of CONTENTS that exists, once."""
    seen = {root_doc}
    for caption, patterns in CONTENTS.items():
        found = [page for one in patterns for page in sorted(ROOT.glob(one)) if "node_modules" not in page.parts]
        pages = dict.fromkeys(name_of(page) for page in found if page.name == "README.md" or stands_alone(page))
        yield toctree([page for page in pages if page not in seen], caption)
        seen.update(pages)


def name_of(page):
    """As Sphinx calls it."""
    return str(page.relative_to(ROOT).with_suffix(""))


def stands_alone(page):
    """Whether no README beside it leads to it."""
    return page.parent == ROOT or not page.with_name("README.md").exists()


def with_contents(_app, docname, source):
    """Append the sidebar's part to the start page and to a folder's README; in the repository it would be noise."""
    if docname == root_doc:
        source[0] = "\n\n".join([source[0], *contents()])
    elif docname.endswith("/README"):
        text = source[0]  # names the pages in their order
        beside = [each for each in (ROOT / docname).parent.glob("[!R]*") if each.suffix in {".md", ".ipynb"}]
        beside.sort(key=lambda page: (text.find(f"({page.name}"), page))
        source[0] = f"{source[0]}\n\n{toctree([page.stem for page in beside])}"


def folders_as_text(app, doctree):
    """Take away links to folders, which lead somewhere in the repository only."""
    here = (ROOT / app.env.docname).parent
    for link in list(doctree.findall(addnodes.pending_xref)):
        if link["reftype"] == "myst" and link["reftarget"] and (here / link["reftarget"]).is_dir():
            link.replace_self(link.children)


def with_download(app, doctree):
    """Offer a notebook below its heading as a file, without outputs."""
    file = f"{app.env.docname}.ipynb"
    if (ROOT / file).exists():
        link = addnodes.download_reference(
            reftarget=f"/{file}", refdoc=app.env.docname, refdomain="", reftype="download"
        )
        link += nodes.literal(text=Path(file).name)
        heading = next(doctree.findall(nodes.title))
        offer = nodes.paragraph("", "", nodes.Text("Download "), link, nodes.Text(" and run it ("))
        offer += addnodes.pending_xref(
            "", nodes.inline(text="how"), reftype="doc", refdomain="std", refdoc=app.env.docname, refexplicit=True,
            reftarget="/docs/tutorials/notebooks/README", refwarn=True,
        )  # fmt: skip
        offer += nodes.Text(").")
        heading.parent.insert(heading.parent.index(heading) + 1, offer)


def without_field_numbers(_app, _what, _name, _subject, _options, lines):
    """Leave out what Python itself says of a NamedTuple's field."""
    if lines and lines[0].startswith("Alias for field number"):
        lines.clear()


def without_fields(_app, what, _name, subject, _options, _signature, returns):
    """Leave out the signature of a class whose fields are listed below it."""
    listed = what == "class" and (is_dataclass(subject) or issubclass(subject, tuple) or is_protocol(subject))
    return ("", returns) if listed else None


def is_protocol(subject):
    """Whether the class only says what others have."""
    return getattr(subject, "_is_protocol", False)


def setup(app):
    """Sphinx calls it."""
    app.connect("source-read", with_contents)
    app.connect("doctree-read", folders_as_text)
    app.connect("doctree-read", with_download, priority=100)  # before downloads are collected
    app.connect("autodoc-process-docstring", without_field_numbers)
    app.connect("autodoc-process-signature", without_fields)

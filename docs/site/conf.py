"""Configuration of Sphinx for the pages that docs/site/build.py gathers; every warning is an error there."""

from pygments.lexers.data import YamlLexer

project = "inertial-bench"
extensions = ["myst_nb"]
myst_heading_anchors = 4  # links to headings, as the pages write them
nb_execution_mode = "force"  # every notebook runs when the site is built
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_show_tb = True
smartquotes = False  # two hyphens begin an option
html_theme = "furo"
html_title = "inertial-bench"
html_show_sourcelink = False
html_show_copyright = False
html_static_path = ["static"]
html_css_files = ["site.css"]


def _reachable(app, pagename, templatename, context, doctree):
    """Let blocks of code that scroll sideways be reached by keyboard, and give headings of the menu their level."""
    del app, pagename, templatename, doctree
    for part in ("body", "furo_navigation_tree"):
        text = context.get(part, "").replace("<pre>", '<pre tabindex="0">')
        context[part] = text.replace('role="heading"', 'role="heading" aria-level="2"')


def setup(app):
    """Know the language of a block; change pages behind the theme, which makes the menu with priority 500."""
    app.add_lexer("prometheus", YamlLexer)  # its configuration is YAML, and none of ours
    app.connect("html-page-context", _reachable, priority=900)

# Copyright 2026 The carracing_dqn authors
# SPDX-License-Identifier: Apache-2.0
"""
The site that `make docs` makes of the pages, by Sphinx as the documentation of ROS 2 is.

Its source is the checkout, not this folder, so that README, changes and the cards of the models
are pages of it. The navigation is what docs/index.md lists.
"""
from pathlib import Path
import posixpath
import re
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]

project = 'carracing_dqn'
author = 'The carracing_dqn authors'
copyright = '2026, the carracing_dqn authors'  # noqa: A001
release = version = ElementTree.parse(ROOT / 'package.xml').findtext('version')

root_doc = 'docs/index'
include_patterns = ['*.md', 'docs/*.md', 'docs/studies/*.md', 'models/*/README.md']
exclude_patterns = ['.*', 'build', 'install', 'log', 'runs', 'tests']

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon', 'sphinx.ext.viewcode']
myst_heading_anchors = 4
myst_url_schemes = ('http', 'https')
default_role = 'code'
autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented'
napoleon_use_ivar = True
# names of fields that several classes have
suppress_warnings = ['ref.python']

html_theme = 'furo'
html_title = f'carracing_dqn {version}'
html_show_sourcelink = False
html_static_path = ['site.css']
html_css_files = ['site.css']


def navigation(app, page, source):
    """Add a hidden tree for each kind of page to the index, of the pages that it lists."""
    if page != root_doc:
        return
    first, *kinds = source[0].split('\n## ')
    for section in (f'\n{first}', *kinds):
        caption, _, text = section.partition('\n')
        pages = [posixpath.normpath(posixpath.join('/docs', link))
                 for link in re.findall(r'\]\(([^):#]+)\.md\)', text)]
        source[0] += '\n'.join([
            '\n', '```{toctree}', ':hidden:', *([f':caption: {caption}'] if caption else []), '',
            *pages, '```', ''])


def no_aliases(app, what, name, member, skip, options):
    """Leave out what Python says of the fields of a named tuple; its class describes them."""
    return skip or (getattr(member, '__doc__', None) or '').startswith('Alias for field number')


def front_page(app, error):
    """Lead from the top of the site to its index."""
    if error is None and app.builder.name == 'html':
        (Path(app.outdir) / 'index.html').write_text(
            '<!doctype html><meta charset="utf-8"><title>carracing_dqn</title>'
            '<meta http-equiv="refresh" content="0; url=docs/index.html">'
            '<a href="docs/index.html">carracing_dqn</a>\n', encoding='utf-8')


def setup(app):
    """Connect what makes the navigation, the API pages and the front page."""
    app.connect('source-read', navigation)
    app.connect('autodoc-skip-member', no_aliases)
    app.connect('build-finished', front_page)

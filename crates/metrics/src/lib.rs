//! pwrfgs: metrics.

//! pwrfgs: data.

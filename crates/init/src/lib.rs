//! pwrfgs: init.

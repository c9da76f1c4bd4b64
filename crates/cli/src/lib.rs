//! pwrfgs: cli.

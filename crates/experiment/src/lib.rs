//! pwrfgs: experiment.

//! pwrfgs: prune.

//! pwrfgs: train.

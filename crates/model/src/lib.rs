//! pwrfgs: model.

//! stub
#![allow(missing_docs)]
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, Default)]
#[serde(default, deny_unknown_fields)]
pub struct Noise {
    pub snr_db: Option<f64>,
    pub phase_error_deg: f64,
}
impl pwrfgs_core::plugin::Check for Noise {
    fn check(&self) -> Result<(), String> {
        Ok(())
    }
}
pub fn add(_: &Noise, _: &mut [crate::Complex], _: u64) {}

//! stub
#![allow(missing_docs)]
use glam::DVec3;
use pwrfgs_core::rng;
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub enum Transmitters {
    Uniform { low: [f64; 3], high: [f64; 3] },
    Grid { low: [f64; 3], high: [f64; 3], step_m: f64 },
    Walk { low: [f64; 3], high: [f64; 3], step_m: f64 },
}
impl Transmitters {
    pub fn check(&self) -> Result<(), String> {
        Ok(())
    }
    pub fn draw(
        &self,
        count: usize,
        seed: u64,
        _f: &dyn Fn(DVec3) -> Result<(), String>,
    ) -> pwrfgs_core::Result<Vec<DVec3>> {
        let (Self::Uniform { low, high } | Self::Grid { low, high, .. } | Self::Walk { low, high, .. }) = self;
        Ok((0..count)
            .map(|i| {
                let mut r = rng::stream(seed, "transmitters", i as u64);
                DVec3::from(*low)
                    + (DVec3::from(*high) - DVec3::from(*low))
                        * DVec3::new(
                            rng::uniform(&mut r) as f64,
                            rng::uniform(&mut r) as f64,
                            rng::uniform(&mut r) as f64,
                        )
            })
            .collect())
    }
}

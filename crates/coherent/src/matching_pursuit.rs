//! `MatchingPursuit`: virtual transmitters found in channels, the start of training.

use crate::links::Links;
use crate::options::Pursuit;
use crate::pursuit::pursue;
use crate::virtual_transmitters::array;
use pwrfgs_core::{
    Documented, Error, GaussianCloud, ImagePlane, Initializer, Observations, Real, Result, Scene, Seen, rng, rng::Rng,
};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;

/// Finds the virtual transmitters of the training channels greedily: the one that explains most, all gains anew by least
/// squares, all places refined, and the next one, as many as a held-out part of the training links wants.
///
/// For `method: VirtualTransmitters()`. Candidates stand on a grid over a box about the transmitters, and at mirror images
/// of what was found. It reads the training part alone; the part held out for the count is learned from at the end. Where the
/// scene alone is asked (`pwrfgs check`), it puts `most` of them anywhere.
///
/// ```
/// # use pwrfgs_core::{Initializer, Plugin};
/// # use pwrfgs_coherent as _;
/// assert!(Plugin::<dyn Initializer>::parse("MatchingPursuit(most: 32, reach: 2.0)").is_ok());
/// assert!(Plugin::<dyn Initializer>::parse("MatchingPursuit(step: 2.0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, Documented)]
#[serde(default, deny_unknown_fields)]
pub struct MatchingPursuit {
    /// Virtual transmitters at most.
    pub most: usize,
    /// How far beyond the positions of the transmitters the box reaches on every side, in sizes of their box.
    pub reach: f64,
    /// Distance of the places of the grid, in the shortest wavelength; a quarter or less finds every hill.
    pub step: f64,
    /// Additions without a better score on the held-out part after which the search stops.
    pub patience: usize,
    /// One of so many training links is held out while the number is chosen; 0 or 1: none, all `most` are kept.
    pub hold_out: usize,
    /// Weight of the ridge on gains, in the share of noise to signal that the fit itself shows.
    pub ridge: f64,
    /// Whether mirror images of what was found are tried too.
    pub images: bool,
}

impl Default for MatchingPursuit {
    fn default() -> Self {
        let Pursuit { most, reach, step, patience, hold_out, ridge, images, .. } = Pursuit::default();
        Self { most, reach, step, patience, hold_out, ridge, images }
    }
}

impl MatchingPursuit {
    fn options(&self, seed: u64) -> Pursuit {
        let Self { most, reach, step, patience, hold_out, ridge, images } = *self;
        Pursuit { reach, step, most, patience, hold_out, ridge, images, seed, ..Pursuit::default() }
    }
}

#[typetag::serde]
impl Initializer for MatchingPursuit {
    fn initialize(&self, scene: &Scene, _: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let (low, high) = scene.bounds;
        let mut cloud = GaussianCloud::zeros(self.most);
        for (mean, signal) in cloud.means.iter_mut().zip(&mut cloud.signals) {
            *mean = std::array::from_fn(|k| low[k] + (high[k] - low[k]) * rng::uniform(rng));
            *signal = [0.1 * rng::normal(rng), 0.1 * rng::normal(rng)];
        }
        cloud.quats.iter_mut().for_each(|quat| *quat = [1.0, 0.0, 0.0, 0.0]);
        Ok(cloud)
    }

    fn search(&self, seen: &Seen<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        let Observations::Channels(channels) = &seen.data.observations else {
            let what = seen.data.kind().plural();
            return Err(Error::Config(format!(
                "initializer: MatchingPursuit searches channels, and the data are {what}"
            )));
        };
        let scene = &seen.data.scene;
        if scene.receivers.len() != 1 || !seen.data.placed {
            return Err(Error::Config(
                "initializer: MatchingPursuit needs one receiver, and transmitters whose positions are known".into(),
            ));
        }
        let positions: Vec<[Real; 3]> =
            seen.train.iter().map(|&i| scene.origin.local(seen.data.sample(i).tx)).collect();
        let antennas = array(&scene.receivers[0]);
        let links = Links { positions: &positions, antennas: &antennas, frequencies: &channels.frequencies_hz };
        let channel: Vec<[Real; 2]> = seen.train.iter().flat_map(|&i| channels.of(i)).copied().collect();
        let seed = (0..4).fold(0, |seed, _| seed << 16 | rng::below(rng, 1 << 16) as u64);
        // Twice over: with a part held out, and at the end with all.
        let found = pursue(&links, &channel, &self.options(seed), &mut |told| {
            (seen.progress)(told.sources, self.most);
            !seen.stop.load(Ordering::Relaxed)
        });
        if seen.stop.load(Ordering::Relaxed) {
            return Err(Error::Stopped);
        }
        Ok(found.map_err(|why| Error::Config(format!("initializer: MatchingPursuit: {why}")))?.to_cloud())
    }

    fn about(&self) -> &'static str {
        "virtual transmitters found in the training channels by orthogonal matching pursuit"
    }

    fn check(&self) -> Result<(), String> {
        self.options(0).check()
    }
}

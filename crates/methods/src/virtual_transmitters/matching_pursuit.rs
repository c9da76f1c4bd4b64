//! `MatchingPursuit`: virtual transmitters found in channels, the start of training.

use crate::virtual_transmitters::links::{Links, Sources};
use crate::virtual_transmitters::method::{VirtualTransmitters, array, order_of};
use crate::virtual_transmitters::options::{Progress as Told, Pursuit};
use crate::virtual_transmitters::pursuit::pursue;
use pwrfgs_core::{
    Error, GaussianCloud, ImagePlane, Initializer, JsonSchema, Real, Result, Scene, Seen, Task, rng, rng::Rng,
};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;

/// Finds the virtual transmitters of the training channels greedily: the one that explains most, all gains anew by least
/// squares, all places refined, and the next one, as many as a held-out part of the training links wants.
///
/// For `method: VirtualTransmitters()`, with gains of its `order`. Candidates are the receiver itself, places of a grid about the transmitters, coarser
/// the farther they are, and mirror images of what was found. It reads the training part alone; the part held out for the count is learned from at the end. Where the
/// scene alone is asked (`pwrfgs check`), it puts `most` of them anywhere.
///
/// ```
/// # use pwrfgs_core::{Initializer, Plugin};
/// # use pwrfgs_methods as _;
/// assert!(Plugin::<dyn Initializer>::parse("MatchingPursuit(most: 32, reach: 2.0)").is_ok());
/// assert!(Plugin::<dyn Initializer>::parse("MatchingPursuit(step: 2.0)").is_err());
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MatchingPursuit {
    /// Virtual transmitters at most, of each search.
    pub most: usize,
    /// How far beyond the positions of the transmitters the grid reaches in every direction, in the longest side of their
    /// box.
    pub reach: f64,
    /// Distance of the places of the grid near those positions, in the shortest wavelength; a quarter or less finds every
    /// hill.
    pub step: f64,
    /// Additions without a better score on the held-out part after which the search stops.
    pub patience: usize,
    /// One of so many training links is held out while the number is chosen; 0 or 1: none, all `most` are kept.
    pub hold_out: usize,
    /// Times that the least needed are taken away again and others searched in their place.
    pub rounds: usize,
    /// Weight of the ridge on gains, in the share of noise to signal that the fit itself shows.
    pub ridge: f64,
    /// Whether mirror images of what was found are tried too.
    pub images: bool,
    /// Searches, each with another part held out: the start is the mean of what they find, as many Gaussians as all of them
    /// found. What is found by accident differs from search to search, and fades in the mean.
    pub searches: usize,
}

impl Default for MatchingPursuit {
    fn default() -> Self {
        let Pursuit { most, reach, step, patience, hold_out, rounds, ridge, images, .. } = Pursuit::default();
        Self { most, reach, step, patience, hold_out, rounds, ridge, images, searches: 1 }
    }
}

impl MatchingPursuit {
    fn options(&self, order: usize, seed: u64) -> Pursuit {
        let Self { most, reach, step, patience, hold_out, rounds, ridge, images, searches: _ } = *self;
        Pursuit { reach, step, most, patience, hold_out, ridge, rounds, images, order, seed, ..Pursuit::default() }
    }
}

#[typetag::serde]
impl Initializer for MatchingPursuit {
    fn initialize(&self, scene: &Scene, _: &ImagePlane, rng: &mut Rng) -> Result<GaussianCloud> {
        let (low, high) = scene.bounds;
        let mut cloud = GaussianCloud::zeros(self.searches * self.most);
        for (mean, signal) in cloud.means.iter_mut().zip(&mut cloud.signals) {
            *mean = std::array::from_fn(|k| low[k] + (high[k] - low[k]) * rng::uniform(rng));
            *signal = [0.1 * rng::normal(rng), 0.1 * rng::normal(rng)];
        }
        cloud.quats.iter_mut().for_each(|quat| *quat = [1.0, 0.0, 0.0, 0.0]);
        Ok(cloud)
    }

    fn search(&self, seen: &Seen<'_>, rng: &mut Rng) -> Result<GaussianCloud> {
        let Some(channels) = seen.data.observations.channels() else {
            let what = seen.data.task().plural;
            return Err(Error::Config(format!(
                "initializer: MatchingPursuit searches channels, and the data are {what}"
            )));
        };
        let method: &dyn std::any::Any = seen.method;
        if !method.is::<VirtualTransmitters>() {
            return Err(Error::Config(
                "initializer: MatchingPursuit finds virtual transmitters; add `method: VirtualTransmitters()`".into(),
            ));
        }
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
        let node = Some(scene.receivers[0].pose.position);
        let order = order_of(&seen.method.traits().columns);
        let mut all = Sources::new(order);
        for search in 0..self.searches {
            let seed = (0..4).fold(0, |seed, _| seed << 16 | rng::below(rng, 1 << 16) as u64);
            let options = Pursuit { node, ..self.options(order, seed) };
            let total = self.searches * self.most;
            let tell = &mut |told: &Told| (seen.progress)(search * self.most + told.sources, total);
            let found = pursue(&links, &channel, &options, seen.stop, tell);
            if seen.stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            all.extend(found.map_err(|why| Error::Config(format!("initializer: MatchingPursuit: {why}")))?);
        }
        all.gains.as_flattened_mut().iter_mut().for_each(|x| *x /= self.searches as f64);
        Ok(all.to_cloud())
    }

    fn supports(&self, task: Task) -> bool {
        task.is_complex
    }

    fn check(&self) -> Result<(), String> {
        if !(1..=100).contains(&self.searches) {
            return Err(format!("`searches` is {}; give 1 to 100", self.searches));
        }
        self.options(0, 0).check()
    }
}

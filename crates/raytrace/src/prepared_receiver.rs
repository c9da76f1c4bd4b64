//! `PreparedReceiver`: one prepared receiver of a scene.

use crate::array::{ArrayWavefront, array_channel};
use crate::observe::{NoiseDraw, ObservationKind, ReceiverObservation, SimulatedObservation, add_noise, power_dbm};
use crate::path::PropagationPath;
use crate::scene::{Noise, SceneFile, SceneReceiver};
use crate::spectrum::{Beamformer, HEIGHT, WIDTH};
use crate::tracer::Tracer;
use crate::world::World;
use crate::{Complex, SPEED_OF_LIGHT};
use glam::DVec3;
use pwrfgs_core::{Error, Pose, Result};
use std::sync::Arc;

/// Largest memory of the tracers of all antennas, bytes.
pub(crate) const MOST_BYTES: usize = 2 << 30;

/// Prepared receiver of a scene: image trees and beamformer, everything independent of the transmitter.
#[derive(Debug)]
pub struct PreparedReceiver {
    scene: Arc<SceneFile>,
    receiver: SceneReceiver,
    /// Tracer of the array centre; with [`ArrayWavefront::Traced`] followed by one per element.
    tracers: Vec<Tracer>,
    beamformer: Beamformer,
}

impl PreparedReceiver {
    /// Prepares `receiver` of `scene`.
    ///
    /// # Errors
    /// An antenna or the array centre is outside free space, too many images, or too much memory.
    pub(crate) fn new(scene: &Arc<SceneFile>, receiver: &SceneReceiver, world: &Arc<World>) -> Result<Self> {
        let points = traced_points(scene, receiver, world)?;
        let tracer = |point: &DVec3| {
            Tracer::new(world, scene, receiver, *point).ok_or_else(|| {
                Error::Config(format!(
                    "scene `{}`: its {} faces give {} too many images; lower `order` of its propagation, or simplify its \
                     meshes",
                    scene.name,
                    world.faces.len(),
                    receiver.describe("the receiver")
                ))
            })
        };
        let mut tracers = vec![tracer(&points[0])?];
        let bytes = tracers[0].memory_bytes().saturating_mul(points.len());
        if bytes > MOST_BYTES {
            return Err(Error::Config(format!(
                "scene `{}`: tracing to each of {} antennas would take {} GB; use the wavefront `Spherical`, fewer rows and \
                 columns, or a lower `order`",
                scene.name,
                points.len() - 1,
                bytes >> 30
            )));
        }
        for point in &points[1..] {
            tracers.push(tracer(point)?);
        }
        let beamformer = Beamformer::new(&receiver.array, WIDTH, HEIGHT);
        Ok(Self { scene: Arc::clone(scene), receiver: receiver.clone(), tracers, beamformer })
    }

    /// Returns the description of the receiver; with several carriers, its name is that of the carrier.
    pub fn receiver(&self) -> &SceneReceiver {
        &self.receiver
    }

    /// Returns the receiver pose, world frame.
    pub fn pose(&self) -> Pose {
        self.receiver.pose()
    }

    /// Returns the antenna positions `[A]`, world frame, metres.
    pub fn antenna_positions(&self) -> Vec<DVec3> {
        self.receiver.antenna_positions(self.scene.wavelength())
    }

    /// Returns the approximate memory use of the tracers, bytes.
    pub(crate) fn memory_bytes(&self) -> usize {
        self.tracers.iter().map(Tracer::memory_bytes).sum()
    }

    /// Returns the paths from `tx`, metres, world frame, to the centre of the array.
    pub fn trace(&self, tx: DVec3) -> Vec<PropagationPath> {
        self.tracers[0].trace(tx)
    }

    /// Returns the channel h `[antennas, frequencies]` of a transmitter at `tx`, metres, world frame, without receiver
    /// errors; frequencies in Hz. Each frequency has a separate wavenumber; path gains are those at the carrier.
    ///
    /// `paths` are those of [`Self::trace`]. [`ArrayWavefront::Traced`] ignores them and traces `tx` to each antenna.
    pub fn channel(&self, tx: DVec3, paths: &[PropagationPath], frequencies: &[f64]) -> Vec<Complex> {
        let wavelengths: Vec<f64> = frequencies.iter().map(|f| SPEED_OF_LIGHT / f).collect();
        if self.tracers.len() == 1 {
            let (antennas, centre) = (self.antenna_positions(), DVec3::from(self.receiver.position));
            return array_channel(paths, &antennas, centre, &wavelengths, self.receiver.array.wavefront);
        }
        self.tracers[1..].iter().flat_map(|tracer| sum_gains(&tracer.trace(tx), &wavelengths)).collect()
    }

    /// Returns the observation of a transmitter at `tx`, metres, world frame. `sample` selects the random errors; `None`: no
    /// errors.
    pub fn observe(&self, tx: DVec3, kind: &ObservationKind, sample: Option<u64>) -> ReceiverObservation {
        let mut noise = Noise::clone(&self.scene.noise);
        if let ObservationKind::Channel { snr_db: Some(snr) } = *kind {
            noise.snr_db = Some(snr);
        }
        let hz = match kind {
            ObservationKind::Spectrum => vec![self.scene.carrier_hz],
            ObservationKind::Power { .. } | ObservationKind::Channel { .. } => self.scene.frequencies(),
        };
        let paths = self.trace(tx);
        let mut channel = self.channel(tx, &paths, &hz);
        let draw = sample.map(|sample| NoiseDraw { receiver: &self.receiver, sample });
        if let Some(draw) = draw {
            add_noise(&noise, &mut channel, hz.len(), draw);
        }
        let observed = match *kind {
            ObservationKind::Spectrum => {
                SimulatedObservation::Spectrum(self.beamformer.spectrum(&channel, self.scene.spectrum))
            }
            ObservationKind::Power { noise_db } => {
                let draw = draw.map(|draw| (noise.seed, draw));
                let sent_dbm = self.scene.transmitter.power_dbm;
                SimulatedObservation::Power(power_dbm(&channel, sent_dbm, noise_db, draw))
            }
            ObservationKind::Channel { .. } => SimulatedObservation::Channel(channel),
        };
        ReceiverObservation { observed, paths }
    }
}

/// Returns the sum of the gains of `paths`, with the phases of their delays, at each wavelength (metres).
fn sum_gains(paths: &[PropagationPath], wavelengths: &[f64]) -> Vec<Complex> {
    let sum = |wavelength: &f64| paths.iter().map(|path| path.baseband_gain(*wavelength)).sum::<Complex>();
    wavelengths.iter().map(sum).collect()
}

/// Returns the points that paths lead to, metres: the array centre, and the elements if each is traced. Returns an error if
/// one of them is not in free space.
fn traced_points(scene: &SceneFile, receiver: &SceneReceiver, world: &World) -> Result<Vec<DVec3>> {
    let centre = DVec3::from(receiver.position);
    world.check_free(centre).map_err(|obstacle| {
        let subject = receiver.describe("the receiver");
        Error::Config(format!("scene `{}`: {subject} at {:?} is {obstacle}; move it", scene.name, receiver.position))
    })?;
    let mut points = vec![centre];
    if receiver.array.wavefront == ArrayWavefront::Traced {
        points.extend(receiver.antenna_positions(scene.wavelength()));
    }
    for point in &points[1..] {
        world.check_free(*point).map_err(|obstacle| {
            Error::Config(format!(
                "scene `{}`: an antenna of the array, at {point}, is {obstacle}; move it",
                scene.name
            ))
        })?;
    }
    Ok(points)
}

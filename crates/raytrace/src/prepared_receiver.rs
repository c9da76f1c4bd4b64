//! `PreparedReceiver`: one prepared receiver of a scene.

use crate::array::{self, ArrayWavefront};
use crate::observe::{NoiseDraw, ObservationKind, ReceiverObservation, SimulatedObservation, add_noise, reading};
use crate::path::PropagationPath;
use crate::scene::{Noise, SceneFile, SceneReceiver};
use crate::spectrum::{Beamformer, HEIGHT, Spectrum, WIDTH};
use crate::tracer::{Antenna, Antennas, Tracer};
use crate::world::World;
use crate::{Complex, SPEED_OF_LIGHT};
use glam::{DMat3, DQuat, DVec3};
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

/// Spectrum and paths of one transmitter at an array.
#[derive(Clone, Debug, PartialEq)]
pub struct ReceivedPaths {
    /// Spatial spectrum.
    pub spectrum: Spectrum,
    /// Paths to the centre of the array.
    pub paths: Vec<PropagationPath>,
}

impl PreparedReceiver {
    /// Prepares `receiver` of `scene`.
    ///
    /// # Errors
    /// An antenna inside an object, too many images or too much memory.
    pub(crate) fn new(scene: &Arc<SceneFile>, receiver: &SceneReceiver, world: &Arc<World>) -> Result<Self> {
        let points = traced_points(scene, receiver, world)?;
        let antennas = antennas(scene, receiver);
        let tracer = |point: &DVec3| {
            let (world, antennas) = (Arc::clone(world), antennas.clone());
            Tracer::new(world, scene.wavelength(), antennas, *point, &scene.propagation)
        };
        let tracer = |point: &DVec3| {
            tracer(point).ok_or_else(|| {
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
        let bytes = tracers[0].bytes().saturating_mul(points.len());
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

    /// Returns the receiver description of the scene.
    pub fn receiver(&self) -> &SceneReceiver {
        &self.receiver
    }

    /// Returns the receiver pose, world frame.
    pub fn pose(&self) -> Pose {
        self.receiver.pose()
    }

    /// Returns the antenna positions `[A]`, world frame, metres.
    pub fn antennas(&self) -> Vec<DVec3> {
        elements(&self.scene, &self.receiver)
    }

    /// Returns the rotation from the receiver axes to the world axes.
    pub fn world_from_receiver(&self) -> DMat3 {
        world_from_receiver(&self.pose())
    }

    /// Returns the approximate memory use of the tracers, bytes.
    pub(crate) fn bytes(&self) -> usize {
        self.tracers.iter().map(Tracer::bytes).sum()
    }

    /// Returns the paths from `tx` to the centre of the array.
    pub fn trace(&self, tx: DVec3) -> Vec<PropagationPath> {
        self.tracers[0].trace(tx)
    }

    /// Returns the channel h `[antennas, frequencies]` without receiver errors, from the paths of `tx`; frequencies in
    /// Hz. Each frequency has its own wavenumber; path gains are those at the carrier.
    pub fn channel(&self, tx: DVec3, paths: &[PropagationPath], frequencies: &[f64]) -> Vec<Complex> {
        let wavelengths: Vec<f64> = frequencies.iter().map(|f| SPEED_OF_LIGHT / f).collect();
        if self.tracers.len() == 1 {
            let center = DVec3::from(self.receiver.position);
            return array::band_at(paths, &self.antennas(), center, &wavelengths, self.receiver.array.wavefront);
        }
        let element_channel = |tracer: &Tracer| {
            let paths = tracer.trace(tx);
            let sum = |wavelength: &f64| paths.iter().map(|path| path.baseband(*wavelength)).sum();
            wavelengths.iter().map(sum).collect::<Vec<Complex>>()
        };
        self.tracers[1..].iter().flat_map(element_channel).collect()
    }

    /// Returns the spectrum of `tx`. `sample` selects the random receiver errors of the scene; `None`: no errors.
    pub fn spectrum(&self, tx: DVec3, sample: Option<u64>) -> ReceivedPaths {
        let (channel, paths) = self.receive(tx, &[self.scene.carrier_hz], &self.scene.noise, sample);
        ReceivedPaths { spectrum: self.beamformer.spectrum(&channel, self.scene.spectrum), paths }
    }

    /// Returns the observation of `tx`. `sample` selects the random errors; `None`: no errors.
    pub fn observe(&self, tx: DVec3, kind: &ObservationKind, sample: Option<u64>) -> ReceiverObservation {
        match *kind {
            ObservationKind::Spectrum => {
                let ReceivedPaths { spectrum, paths } = self.spectrum(tx, sample);
                ReceiverObservation { observed: SimulatedObservation::Spectrum(spectrum), paths }
            }
            ObservationKind::Power { noise_db } => {
                let noise = &self.scene.noise;
                let (channel, paths) = self.receive(tx, &self.scene.frequencies(), noise, sample);
                let draw = sample.map(|sample| (noise.seed, NoiseDraw { receiver: &self.receiver, sample }));
                let power = reading(&channel, self.scene.transmitter.power_dbm, noise_db, draw);
                ReceiverObservation { observed: SimulatedObservation::Power(power), paths }
            }
            ObservationKind::Channel { snr_db } => {
                let noise = Noise { snr_db: snr_db.or(self.scene.noise.snr_db), ..(*self.scene.noise).clone() };
                let (channel, paths) = self.receive(tx, &self.scene.frequencies(), &noise, sample);
                ReceiverObservation { observed: SimulatedObservation::Channel(channel), paths }
            }
        }
    }

    /// Returns the channel `[antennas, frequencies]` with errors, and its paths.
    fn receive(
        &self,
        tx: DVec3,
        hz: &[f64],
        noise: &Noise,
        sample: Option<u64>,
    ) -> (Vec<Complex>, Vec<PropagationPath>) {
        let paths = self.trace(tx);
        let mut channel = self.channel(tx, &paths, hz);
        if let Some(sample) = sample {
            add_noise(noise, &mut channel, hz.len(), NoiseDraw { receiver: &self.receiver, sample });
        }
        (channel, paths)
    }
}

/// Returns the array centre; if each element is traced, followed by the elements. All must be in free space.
fn traced_points(scene: &SceneFile, receiver: &SceneReceiver, world: &World) -> Result<Vec<DVec3>> {
    let center = DVec3::from(receiver.position);
    world.check_free(center).map_err(|obstacle| {
        let subject = receiver.describe("the receiver");
        Error::Config(format!("scene `{}`: {subject} at {:?} is {obstacle}; move it", scene.name, receiver.position))
    })?;
    let mut points = vec![center];
    if receiver.array.wavefront == ArrayWavefront::Traced {
        points.extend(elements(scene, receiver));
    }
    for point in &points {
        world.check_free(*point).map_err(|obstacle| {
            Error::Config(format!(
                "scene `{}`: an antenna of the array, at {point}, is {obstacle}; move it",
                scene.name
            ))
        })?;
    }
    Ok(points)
}

/// Returns the antenna positions `[A]`, world frame, metres. Their spacing refers to the carrier wavelength.
fn elements(scene: &SceneFile, receiver: &SceneReceiver) -> Vec<DVec3> {
    let (center, turn) = (DVec3::from(receiver.position), world_from_receiver(&receiver.pose()));
    receiver.array.offsets(scene.wavelength()).into_iter().map(|offset| center + turn * offset).collect()
}

/// Returns the rotation from the receiver axes to the world axes.
fn world_from_receiver(pose: &Pose) -> DMat3 {
    let [x, y, z, w] = pose.orientation;
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
}

/// Returns the antennas of transmitter and receiver.
fn antennas(scene: &SceneFile, receiver: &SceneReceiver) -> Antennas {
    let array = &receiver.array;
    let transmitter = Antenna {
        element: scene.transmitter.element.clone(),
        axis: DVec3::from(scene.transmitter.polarization).normalize(),
        world_from_antenna: DMat3::IDENTITY,
    };
    let receiver = Antenna {
        element: array.element.clone(),
        axis: DVec3::from(array.polarization).normalize(),
        world_from_antenna: world_from_receiver(&receiver.pose()),
    };
    Antennas { transmitter, receiver }
}

//! `Simulator`: a scene made ready, and a spectrum for every transmitter position.

use crate::array::Wavefront;
use crate::noise;
use crate::patches;
use crate::path::Path;
use crate::room;
use crate::scene::Scene;
use crate::spectrum::{Beamformer, Spectrum};
use crate::surface_points::{self, SurfacePoints};
use crate::tracer::{Antenna, Tracer};
use crate::wave::Complex;
use crate::world::{Triangle, World};
use glam::{DMat3, DQuat, DVec3};
use pwrfgs_core::{Error, Pose, Result};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Columns of a spectrum: azimuths 0 to 359 degrees.
pub const WIDTH: usize = 360;
/// Rows of a spectrum: elevations 0 to 89 degrees.
pub const HEIGHT: usize = 90;

/// Transmitters simulated at a time.
const CHUNK: usize = 32;
/// Most memory of the tracers of all antennas, bytes.
const MOST_BYTES: usize = 2 << 30;

/// A scene made ready: geometry, image trees and beamformer, everything that no transmitter changes.
#[derive(Debug)]
pub struct Simulator {
    scene: Scene,
    world: Arc<World>,
    /// The tracer of the array's centre, and with [`Wavefront::Traced`] one for each element behind it.
    tracers: Vec<Tracer>,
    beamformer: Beamformer,
}

/// What the array receives from one transmitter.
#[derive(Clone, Debug, PartialEq)]
pub struct Reception {
    /// Its picture.
    pub spectrum: Spectrum,
    /// Paths to the centre of the array.
    pub paths: Vec<Path>,
}

impl Simulator {
    /// Makes `scene` ready.
    ///
    /// # Errors
    /// A mesh that cannot be read or is not closed where it must be, a receiver inside something, more images or patches
    /// than can be handled.
    pub fn new(scene: &Scene) -> Result<Self> {
        let world = Arc::new(room::world(scene)?);
        let pose = scene.pose();
        let center = DVec3::from(pose.position);
        world.check_free(center).map_err(|what| {
            Error::Config(format!("scene `{}`: the receiver at {:?} is {what}; move it", scene.name, pose.position))
        })?;
        check_patches(scene, &world)?;
        let wavelength = scene.wavelength();
        let antennas = antennas(scene, &pose);
        let turn = world_from_receiver(&pose);
        let mut places = vec![center];
        if scene.receiver.array.wavefront == Wavefront::Traced {
            places.extend(scene.receiver.array.offsets(wavelength).into_iter().map(|o| center + turn * o));
        }
        for place in &places {
            world.check_free(*place).map_err(|what| {
                Error::Config(format!(
                    "scene `{}`: an antenna of the array, at {place}, is {what}; move it",
                    scene.name
                ))
            })?;
        }
        let tracer = |place: &DVec3| {
            Tracer::new(Arc::clone(&world), wavelength, antennas.clone(), *place, &scene.propagation).ok_or_else(|| {
                Error::Config(format!(
                    "scene `{}`: its {} faces give the receiver too many images; lower `order` of its propagation, or \
                     simplify its meshes",
                    scene.name,
                    world.faces.len()
                ))
            })
        };
        let mut tracers = vec![tracer(&places[0])?];
        let bytes = tracers[0].bytes().saturating_mul(places.len());
        if bytes > MOST_BYTES {
            return Err(Error::Config(format!(
                "scene `{}`: tracing to each of {} antennas would take {} GB; use the wavefront `Spherical`, fewer rows and \
                 columns, or a lower `order`",
                scene.name,
                places.len() - 1,
                bytes >> 30
            )));
        }
        for place in &places[1..] {
            tracers.push(tracer(place)?);
        }
        let beamformer = Beamformer::new(&scene.receiver.array, WIDTH, HEIGHT);
        Ok(Self { scene: scene.clone(), world, tracers, beamformer })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Its geometry.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// From the receiver's axes to the world's.
    pub fn world_from_receiver(&self) -> DMat3 {
        world_from_receiver(&self.scene.pose())
    }

    /// Images of the receiver that are tried for each transmitter.
    pub fn images(&self) -> usize {
        self.tracers[0].images()
    }

    /// Paths from `tx` to the centre of the array.
    pub fn trace(&self, tx: DVec3) -> Vec<Path> {
        self.tracers[0].trace(tx)
    }

    /// The channel h of the array's elements, without errors of the receiver, from the paths of `tx`.
    pub fn channel(&self, tx: DVec3, paths: &[Path]) -> Vec<Complex> {
        let (pose, wavelength) = (self.scene.pose(), self.scene.wavelength());
        match self.tracers.split_first() {
            Some((_, elements)) if !elements.is_empty() => elements
                .iter()
                .map(|tracer| tracer.trace(tx).iter().map(|path| path.baseband(wavelength)).sum())
                .collect(),
            _ => {
                let array = &self.scene.receiver.array;
                array.channel(paths, DVec3::from(pose.position), world_from_receiver(&pose), wavelength)
            }
        }
    }

    /// The spectrum of `tx`. `noise` is the number of the draw of the scene's receiver errors; `None`: without any.
    pub fn spectrum(&self, tx: DVec3, noise: Option<u64>) -> Reception {
        let paths = self.trace(tx);
        let mut channel = self.channel(tx, &paths);
        if let Some(draw) = noise {
            noise::add(&self.scene.noise, &mut channel, draw);
        }
        Reception { spectrum: self.beamformer.spectrum(&channel, self.scene.spectrum), paths }
    }

    /// Positions of `count` transmitters.
    ///
    /// # Errors
    /// No room for them, or a grid point inside something.
    pub fn positions(&self, count: usize, seed: u64) -> Result<Vec<DVec3>> {
        let free = |point: DVec3| self.world.check_free(point);
        let drawn = self.scene.transmitter.positions.draw(count, seed, &free);
        drawn.map_err(|e| Error::Config(format!("scene `{}`: {e}", self.scene.name)))
    }

    /// `count` points on all surfaces, with normals.
    pub fn surface_points(&self, count: usize, seed: u64) -> SurfacePoints {
        let triangles: Vec<[DVec3; 3]> = self.world.triangles.iter().map(Triangle::corners).collect();
        let normals: Vec<DVec3> =
            self.world.triangles.iter().map(|t| self.world.faces[t.face as usize].normal).collect();
        surface_points::sample(&triangles, &normals, count, seed)
    }
}

/// Simulates `samples` transmitters, with the scene's receiver errors, and shows each with its position to `each`, in
/// order. Memory holds a few at a time; bits do not depend on threads.
///
/// # Errors
/// Those of [`Simulator::positions`] and of `each`; a channel that is not finite.
pub fn simulate(
    simulator: &Simulator,
    samples: usize,
    seed: u64,
    each: impl FnMut(usize, DVec3, Reception) -> Result<()>,
) -> Result<()> {
    simulate_until(simulator, samples, seed, &AtomicBool::new(false), each)
}

/// As [`simulate`], between two transmitters until `stop` is set.
///
/// # Errors
/// Those of [`simulate`], and [`Error::Stopped`].
pub(crate) fn simulate_until(
    simulator: &Simulator,
    samples: usize,
    seed: u64,
    stop: &AtomicBool,
    mut each: impl FnMut(usize, DVec3, Reception) -> Result<()>,
) -> Result<()> {
    let positions = simulator.positions(samples, seed)?;
    for (c, chunk) in positions.chunks(CHUNK).enumerate() {
        let draw = |i: usize| seed.wrapping_mul(1 << 32).wrapping_add((c * CHUNK + i) as u64);
        let receive = |(i, tx): (usize, &DVec3)| {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            Ok(simulator.spectrum(*tx, Some(draw(i))))
        };
        let receptions: Vec<Reception> = chunk.par_iter().enumerate().map(receive).collect::<Result<_>>()?;
        for ((i, tx), reception) in chunk.iter().enumerate().zip(receptions) {
            if !(reception.spectrum.power.is_finite() && reception.spectrum.high.is_finite()) {
                let (scene, number) = (&simulator.scene.name, c * CHUNK + i + 1);
                let what = "gives a field that is not finite; correct materials and places";
                return Err(Error::Config(format!("scene `{scene}`: transmitter {number} at {tx} {what}")));
            }
            each(c * CHUNK + i, *tx, reception)?;
        }
    }
    Ok(())
}

/// Refuses more patches than can be traced in reasonable time.
fn check_patches(scene: &Scene, world: &World) -> Result<()> {
    const MOST: f64 = 300_000.0;
    // Of the rectangle about a slanted or thin face most places lie beside it.
    const MOST_CELLS: f64 = 10.0 * MOST;
    let is_rough = |t: &&Triangle| world.surface_of(t.face).roughness > 0.0;
    let area: f64 = world.triangles.iter().filter(is_rough).map(Triangle::area).sum();
    let side = scene.propagation.patch_m;
    let rough = || world.faces.iter().filter(|face| world.surfaces[face.surface as usize].roughness > 0.0);
    let cells: f64 = rough().map(|face| patches::cells(face, side)).sum();
    if area / (side * side) <= MOST && cells <= MOST_CELLS && rough().count() as f64 <= MOST {
        return Ok(());
    }
    Err(Error::Config(format!(
        "scene `{}`: {area:.0} m² of rough surface on {} faces in patches of {side} m are too many; give a larger \
         `patch_m`, such as {:.2}, or smooth meshes",
        scene.name,
        rough().count(),
        (area / 10_000.0).sqrt().max(2.0 * side)
    )))
}

fn world_from_receiver(pose: &Pose) -> DMat3 {
    let [x, y, z, w] = pose.orientation;
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
}

/// Transmitter and receiver.
fn antennas(scene: &Scene, pose: &Pose) -> (Antenna, Antenna) {
    let array = &scene.receiver.array;
    let transmitter = Antenna {
        element: scene.transmitter.element.clone(),
        axis: DVec3::from(scene.transmitter.polarization).normalize(),
        world_from_antenna: DMat3::IDENTITY,
    };
    let receiver = Antenna {
        element: array.element.clone(),
        axis: DVec3::from(array.polarization).normalize(),
        world_from_antenna: world_from_receiver(pose),
    };
    (transmitter, receiver)
}

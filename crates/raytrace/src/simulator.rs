//! `Simulator`: a scene made ready, and what its receivers observe of every transmitter position.

use crate::listener::{Listener, MOST_BYTES};
use crate::observe::{Heard, Observe};
use crate::patches;
use crate::path::Path;
use crate::scene::Scene;
use crate::surface_points::{self, SurfacePoints};
use crate::world::{self, MARGIN, Triangle, World};
use glam::DVec3;
use pwrfgs_core::{Error, Result};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Transmitters simulated at a time.
const CHUNK: usize = 32;

/// A scene made ready: geometry and receivers, everything that no transmitter changes.
#[derive(Debug)]
pub struct Simulator {
    scene: Arc<Scene>,
    world: Arc<World>,
    /// At least one.
    listeners: Vec<Listener>,
}

impl Simulator {
    /// Makes `scene` ready.
    ///
    /// # Errors
    /// A mesh that cannot be read or is not closed where it must be, a receiver inside something, more images or patches
    /// than can be handled.
    pub fn new(scene: &Scene) -> Result<Self> {
        let (scene, world) = (Arc::new(scene.clone()), Arc::new(world::from_scene(scene)?));
        check_patches(&scene, &world)?;
        let mut listeners: Vec<Listener> = Vec::new();
        for receiver in scene.receivers() {
            listeners.push(Listener::new(&scene, receiver, &world)?);
            check_memory(&scene, &listeners)?;
        }
        Ok(Self { scene, world, listeners })
    }

    /// The scene.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Its geometry.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Its receivers, in the order of the scene; the first is `receiver`.
    pub fn listeners(&self) -> &[Listener] {
        &self.listeners
    }

    /// Paths from `tx` to the centre of the first receiver's array.
    pub fn trace(&self, tx: DVec3) -> Vec<Path> {
        self.listeners[0].trace(tx)
    }

    /// Positions of `count` transmitters.
    ///
    /// # Errors
    /// No room for them, a grid point inside something, or a transmitter in an antenna of a receiver.
    pub fn positions(&self, count: usize, seed: u64) -> Result<Vec<DVec3>> {
        let free = |point: DVec3| self.world.check_free(point);
        let drawn = self.scene.transmitter.positions.draw(count, seed, &free);
        let drawn = drawn.and_then(|positions| self.check_apart(&positions).map(|()| positions));
        drawn.map_err(|e| Error::Config(format!("scene `{}`: {e}", self.scene.name)))
    }

    /// Refuses a transmitter in an antenna, which has no line of sight to it and no finite gain.
    fn check_apart(&self, positions: &[DVec3]) -> Result<()> {
        for listener in &self.listeners {
            let mut places = listener.antennas();
            places.push(DVec3::from(listener.receiver().position));
            let is_in = |tx: &DVec3| places.iter().any(|place| place.distance(*tx) < MARGIN);
            if let Some(i) = positions.iter().position(is_in) {
                let (DVec3 { x, y, z }, who) = (positions[i], listener.receiver().called("the receiver"));
                let what = "move the transmitters or the receiver";
                return Err(Error::Config(format!("transmitter {} at ({x}, {y}, {z}) is in {who}; {what}", i + 1)));
            }
        }
        Ok(())
    }

    /// `count` points on all surfaces, with normals.
    pub fn surface_points(&self, count: usize, seed: u64) -> SurfacePoints {
        let triangles: Vec<[DVec3; 3]> = self.world.triangles.iter().map(Triangle::corners).collect();
        let normals: Vec<DVec3> =
            self.world.triangles.iter().map(|t| self.world.faces[t.face as usize].normal).collect();
        surface_points::sample(&triangles, &normals, count, seed)
    }
}

/// What is simulated.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// What is observed.
    pub what: Observe,
    /// Transmitters.
    pub samples: usize,
    /// Which transmitter positions, and which errors.
    pub seed: u64,
}

/// Simulates what all receivers observe, with all errors, and shows each transmitter with its number, its position and what
/// every receiver hears, in order. Between two transmitters it ends when `stop` is set. Memory holds a few at a time; bits
/// do not depend on threads.
///
/// # Errors
/// Those of [`Simulator::positions`] and of `each`, [`Error::Stopped`]; a channel that is not finite.
pub fn simulate_links(
    simulator: &Simulator,
    wanted: &Wanted,
    stop: &AtomicBool,
    mut each: impl FnMut(usize, DVec3, Vec<Heard>) -> Result<()>,
) -> Result<()> {
    let &Wanted { what, samples, seed } = wanted;
    let positions = simulator.positions(samples, seed)?;
    for (c, chunk) in positions.chunks(CHUNK).enumerate() {
        let draw = |i: usize| seed.wrapping_mul(1 << 32).wrapping_add((c * CHUNK + i) as u64);
        let hear = |(i, tx): (usize, &DVec3)| {
            if stop.load(Ordering::Relaxed) {
                return Err(Error::Stopped);
            }
            Ok(simulator.listeners.iter().map(|listener| listener.observe(*tx, &what, Some(draw(i)))).collect())
        };
        let all: Vec<Vec<Heard>> = chunk.par_iter().enumerate().map(hear).collect::<Result<_>>()?;
        for ((i, tx), heard) in chunk.iter().enumerate().zip(all) {
            if !heard.iter().all(|heard| heard.observed.is_finite()) {
                let (scene, number) = (&simulator.scene.name, c * CHUNK + i + 1);
                let what = "gives a field that is not finite; correct materials and places";
                return Err(Error::Config(format!("scene `{scene}`: transmitter {number} at {tx} {what}")));
            }
            each(c * CHUNK + i, *tx, heard)?;
        }
    }
    Ok(())
}

/// Refuses receivers that together take too much.
fn check_memory(scene: &Scene, listeners: &[Listener]) -> Result<()> {
    let bytes: usize = listeners.iter().map(Listener::bytes).sum();
    if bytes <= MOST_BYTES {
        return Ok(());
    }
    Err(Error::Config(format!(
        "scene `{}`: images for {} of its {} receivers take more than {} GB already; give fewer receivers or a lower `order`",
        scene.name,
        listeners.len(),
        scene.receivers().count(),
        MOST_BYTES >> 30
    )))
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

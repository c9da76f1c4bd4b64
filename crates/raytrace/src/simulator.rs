//! `Simulator`: a prepared scene, and observations of every transmitter at its receivers.

use crate::observe::{ObservationKind, ReceiverObservation};
use crate::patches;
use crate::path::PropagationPath;
use crate::prepared_receiver::{MOST_BYTES, PreparedReceiver};
use crate::scene::{SceneFile, SceneReceiver};
use crate::surface_points::{self, SurfacePoints};
use crate::world::{MARGIN, Triangle, World};
use glam::DVec3;
use pwrfgs_core::{Error, Result, check_stopped};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Number of transmitters simulated at a time.
const CHUNK: usize = 32;

/// Prepared scene: geometry and receivers, everything independent of the transmitter.
#[derive(Debug)]
pub struct Simulator {
    scene: Arc<SceneFile>,
    world: Arc<World>,
    /// Receivers, at least one; with several carriers, one per carrier.
    receivers: Vec<PreparedReceiver>,
}

impl Simulator {
    /// Prepares `scene`.
    ///
    /// # Errors
    /// Errors of [`World::from_scene`], an antenna outside free space, too many images or patches, or too much memory.
    pub fn new(scene: &SceneFile) -> Result<Self> {
        let (scene, world) = (Arc::new(scene.clone()), Arc::new(World::from_scene(scene)?));
        check_patches(&scene, &world)?;
        let mut receivers: Vec<PreparedReceiver> = Vec::new();
        for carrier_scene in scene.per_carrier() {
            let carrier_world = if scene.carriers_hz.is_empty() {
                Arc::clone(&world)
            } else {
                // Materials depend on the carrier.
                Arc::new(World::from_scene(&carrier_scene)?)
            };
            let carrier_scene = Arc::new(carrier_scene);
            for receiver in carrier_scene.receivers() {
                receivers.push(PreparedReceiver::new(&carrier_scene, receiver, &carrier_world)?);
                check_memory(&scene, &receivers)?;
            }
        }
        Ok(Self { scene, world, receivers })
    }

    /// Returns the scene.
    pub fn scene(&self) -> &SceneFile {
        &self.scene
    }

    /// Returns the geometry of the scene.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Returns the receivers, in the order of the scene; the first is `receiver`. With several carriers, one per
    /// carrier.
    pub fn receivers(&self) -> &[PreparedReceiver] {
        &self.receivers
    }

    /// Prepares the first receiver of the scene at another position (metres, world frame).
    ///
    /// # Errors
    /// An antenna outside free space, or too much memory.
    pub fn receiver_at(&self, position: [f64; 3]) -> Result<PreparedReceiver> {
        PreparedReceiver::new(&self.scene, &SceneReceiver { position, ..self.scene.receiver.clone() }, &self.world)
    }

    /// Returns the paths from `tx`, metres, world frame, to the centre of the first receiver's array.
    pub fn trace(&self, tx: DVec3) -> Vec<PropagationPath> {
        self.receivers[0].trace(tx)
    }

    /// Draws the positions of `count` transmitters, metres, world frame.
    ///
    /// # Errors
    /// Errors of [`Transmitters::draw`](crate::scene::Transmitters::draw), or a transmitter at a receiver antenna.
    pub fn draw_positions(&self, count: usize, seed: u64) -> Result<Vec<DVec3>> {
        let free = |point: DVec3| self.world.check_free(point);
        let drawn = self.scene.transmitter.positions.draw(count, seed, &free);
        let drawn = drawn.and_then(|positions| self.check_distances(&positions).map(|()| positions));
        drawn.map_err(|e| Error::Config(format!("scene `{}`: {e}", self.scene.name)))
    }

    /// Returns an error for a transmitter position at a receiver antenna or array centre, where the gain is infinite.
    fn check_distances(&self, positions: &[DVec3]) -> Result<()> {
        for receiver in &self.receivers {
            let mut antennas = receiver.antenna_positions();
            antennas.push(DVec3::from(receiver.receiver().position));
            let is_in = |tx: &DVec3| antennas.iter().any(|antenna| antenna.distance(*tx) < MARGIN);
            if let Some(i) = positions.iter().position(is_in) {
                let (DVec3 { x, y, z }, subject) = (positions[i], receiver.receiver().describe("the receiver"));
                let advice = "move the transmitters or the receiver";
                return Err(Error::Config(format!(
                    "transmitter {} at ({x}, {y}, {z}) is in {subject}; {advice}",
                    i + 1
                )));
            }
        }
        Ok(())
    }

    /// Returns `count` points on all surfaces, uniform by area, metres, world frame, with normals. `seed` sets their
    /// random offsets.
    pub fn surface_points(&self, count: usize, seed: u64) -> SurfacePoints {
        let triangles: Vec<[DVec3; 3]> = self.world.triangles.iter().map(Triangle::corners).collect();
        let normals: Vec<DVec3> =
            self.world.triangles.iter().map(|t| self.world.faces[t.face as usize].normal).collect();
        surface_points::sample_surfaces(&triangles, &normals, count, seed)
    }
}

/// Settings of a simulation.
#[derive(Clone, Copy, Debug)]
pub struct SimulationRequest {
    /// Observation type.
    pub kind: ObservationKind,
    /// Number of transmitters.
    pub samples: usize,
    /// Random seed of positions and errors.
    pub seed: u64,
}

/// Simulates the observations of all receivers with all errors. Calls `each` in order with number (from 0), position and
/// observations of each transmitter, or of each position of a moving receiver. Stops between two transmitters if `stop`
/// is set. Memory holds a few transmitters at a time; results do not depend on the number of threads.
///
/// # Errors
/// Errors of [`Simulator::draw_positions`] and of `each`, [`Error::Stopped`], or a channel that is not finite.
pub fn simulate_links(
    simulator: &Simulator,
    request: &SimulationRequest,
    stop: &AtomicBool,
    mut each: impl FnMut(usize, DVec3, Vec<ReceiverObservation>) -> Result<()>,
) -> Result<()> {
    let &SimulationRequest { kind, samples, seed } = request;
    let (positions, scene) = (simulator.draw_positions(samples, seed)?, &simulator.scene);
    for (first, chunk) in (0_usize..).step_by(CHUNK).zip(positions.chunks(CHUNK)) {
        let receive = |(i, tx): (usize, &DVec3)| {
            check_stopped(stop)?;
            // Data sets of different seeds have different draws, since each has fewer than 2³² samples.
            let draw = Some(seed.wrapping_mul(1 << 32).wrapping_add((first + i) as u64));
            match scene.moved_receiver(first + i, *tx, seed) {
                None => Ok(simulator.receivers.iter().map(|receiver| receiver.observe(*tx, &kind, draw)).collect()),
                Some(receiver) => {
                    let receiver = PreparedReceiver::new(scene, &receiver, &simulator.world)?;
                    Ok(vec![receiver.observe(scene.receiver.position.into(), &kind, draw)])
                }
            }
        };
        let batch: Vec<Vec<ReceiverObservation>> = chunk.par_iter().enumerate().map(receive).collect::<Result<_>>()?;
        for ((i, tx), received) in chunk.iter().enumerate().zip(batch) {
            if !received.iter().all(|received| received.observed.is_finite()) {
                let (scene, number) = (&simulator.scene.name, first + i + 1);
                let problem = "gives a field that is not finite; correct materials and positions";
                return Err(Error::Config(format!("scene `{scene}`: transmitter {number} at {tx} {problem}")));
            }
            each(first + i, *tx, received)?;
        }
    }
    Ok(())
}

/// Returns an error if the image trees of the receivers prepared so far need too much memory.
fn check_memory(scene: &SceneFile, receivers: &[PreparedReceiver]) -> Result<()> {
    let bytes: usize = receivers.iter().map(PreparedReceiver::memory_bytes).sum();
    if bytes <= MOST_BYTES {
        return Ok(());
    }
    Err(Error::Config(format!(
        "scene `{}`: images for {} of its {} receivers take more than {} GB already; give fewer receivers or a lower `order`",
        scene.name,
        receivers.len(),
        scene.receivers().count() * scene.carrier_count(),
        MOST_BYTES >> 30
    )))
}

/// Returns an error for too many scattering patches to trace in reasonable time.
fn check_patches(scene: &SceneFile, world: &World) -> Result<()> {
    const MOST: f64 = 300_000.0;
    // Most cells of the bounding rectangle of a slanted or thin face lie outside the face.
    const MOST_CELLS: f64 = 10.0 * MOST;
    let is_rough = |t: &&Triangle| world.surface_of(t.face).roughness > 0.0;
    let area: f64 = world.triangles.iter().filter(is_rough).map(Triangle::area).sum();
    let side = scene.propagation.patch_m;
    let rough = || world.faces.iter().filter(|face| world.surfaces[face.surface as usize].roughness > 0.0);
    let cells: f64 = rough().map(|face| patches::cell_count(face, side)).sum();
    if area / (side * side) <= MOST && cells <= MOST_CELLS && rough().count() as f64 <= MOST {
        return Ok(());
    }
    // The advised side gives at most 10,000 patches.
    Err(Error::Config(format!(
        "scene `{}`: {area:.0} m² of rough surface on {} faces in patches of {side} m are too many; give a larger \
         `patch_m`, such as {:.2}, or smooth meshes",
        scene.name,
        rough().count(),
        (area / 10_000.0).sqrt().max(2.0 * side)
    )))
}

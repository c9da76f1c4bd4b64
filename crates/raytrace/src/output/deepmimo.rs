//! Scenario of DeepMIMO v4: receivers become base stations, transmitters become users, and paths run from base station to user.

use crate::path::{Interaction, PropagationPath, azimuth_elevation_deg};
use crate::prepared_receiver::PreparedReceiver;
use crate::recipe::SimulationRecipe;
use crate::simulator::Simulator;
use glam::DVec3;
use pwrfgs_core::npy::npy_header;
use pwrfgs_core::{Error, Number, Progress, Result, check_stopped, files};
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use zip::{ZipWriter, result::ZipError, write::SimpleFileOptions};

/// Largest number of paths per user in DeepMIMO.
const MOST_PATHS: usize = 25;

/// Function from a path to a number of a matrix.
type PathValue<'a> = &'a dyn Fn(&PropagationPath) -> f64;

/// Writes the matrices of every receiver, `power_t000_tx000_r001.npz` and so on, and `params.json` into `folder`. A user keeps
/// its strongest paths; entries without a path are NaN. Phases contain the delay at the carrier. The files of vertices and
/// objects are empty.
///
/// # Errors
/// Errors of [`Simulator::draw_positions`], a failed write, or [`Error::Stopped`].
pub(super) fn write_scenario(
    recipe: &SimulationRecipe,
    simulator: &Simulator,
    folder: &Path,
    progress: Progress<'_>,
    stop: &AtomicBool,
) -> Result<()> {
    let (users, stations) = (simulator.draw_positions(recipe.samples, recipe.seed)?, simulator.receivers());
    let (done, wavelength) = (AtomicUsize::new(0), simulator.scene().wavelength());
    // Whether each user has a path, and the largest number of each interaction on a path.
    let (mut active, mut most) = (vec![false; users.len()], [0; 4]);
    for (i, station) in stations.iter().enumerate() {
        let trace = |user: &DVec3| {
            check_stopped(stop)?;
            let paths = strongest_paths(station, *user);
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, stations.len() * users.len());
            Ok(paths)
        };
        let paths: Vec<Vec<PropagationPath>> = users.par_iter().map(trace).collect::<Result<_>>()?;
        for (active, paths) in active.iter_mut().zip(&paths) {
            *active |= !paths.is_empty();
            for digits in paths.iter().map(interaction_digits) {
                let count = |kind: usize| digits.iter().filter(|digit| **digit == kind).count();
                most = std::array::from_fn(|k| most[k].max(count(k + 1)));
            }
        }
        let file = |name: &str| folder.join(format!("{name}_t000_tx{i:03}_r001.npz"));
        write_path_matrices(&paths, wavelength, &file)?;
        let positions = users.iter().flat_map(DVec3::to_array).collect::<Vec<f64>>();
        write_npz(&file("rx_pos"), "rx_pos", &[users.len(), 3], &positions)?;
        write_npz(&file("tx_pos"), "tx_pos", &[1, 3], &station.receiver().position)?;
    }
    write_npz(&folder.join("vertices.npz"), "vertices", &[0, 3], &[])?;
    let sets =
        [("base stations", [stations.len(); 2]), ("users", [users.len(), active.iter().filter(|a| **a).count()])];
    let parameters = scenario_parameters(simulator.scene().carrier_hz, most, sets);
    files::write(&folder.join("params.json"), parameters.to_string())?;
    files::write(&folder.join("objects.json"), "[]")
}

/// Returns the strongest paths from `user` to `station`, in descending order of gain, at most as many as DeepMIMO
/// supports. Paths without power are left out.
fn strongest_paths(station: &PreparedReceiver, user: DVec3) -> Vec<PropagationPath> {
    let mut paths = station.trace(user);
    paths.retain(|path| path.gain.norm_sqr() > 0.0); // from behind a patch antenna
    paths.sort_by(|a, b| b.gain.norm_sqr().total_cmp(&a.gain.norm_sqr()));
    paths.truncate(MOST_PATHS);
    paths.shrink_to_fit();
    paths
}

/// Writes the matrices of the paths of all users, `[users, most paths]`; `file` maps the name of a matrix to its path.
/// `wavelength` in metres. Returns an error if a write failed.
fn write_path_matrices(paths: &[Vec<PropagationPath>], wavelength: f64, file: &dyn Fn(&str) -> PathBuf) -> Result<()> {
    let most = paths.iter().map(Vec::len).max().unwrap_or(0).max(1);
    let matrix = |value: PathValue<'_>| {
        let entry = |(user, k): (usize, usize)| paths[user].get(k).map_or(f64::NAN, value);
        (0..paths.len() * most).map(|i| entry((i / most, i % most))).collect::<Vec<f64>>()
    };
    // Waves leave the base station where they arrive in the simulation. Elevations count from the zenith.
    let matrices: [(&str, PathValue<'_>); 8] = [
        ("power", &|path| 20.0 * path.gain.norm().log10()),
        ("phase", &|path| path.baseband_gain(wavelength).arg().to_degrees()),
        ("delay", &PropagationPath::delay),
        ("aod_az", &|path| azimuth_elevation_deg(path.arrival).0),
        ("aod_el", &|path| 90.0 - azimuth_elevation_deg(path.arrival).1),
        ("aoa_az", &|path| azimuth_elevation_deg(path.departure).0),
        ("aoa_el", &|path| 90.0 - azimuth_elevation_deg(path.departure).1),
        ("inter", &|path| interaction_digits(path).iter().fold(0.0, |number, digit| 10.0 * number + *digit as f64)),
    ];
    for (name, value) in matrices {
        write_npz(&file(name), name, &[paths.len(), most], &matrix(value))?;
    }
    let depth = paths.iter().flatten().map(|path| path.interactions.len()).max().unwrap_or(0).max(1);
    let mut points = Vec::with_capacity(paths.len() * most * depth * 3);
    for (user, k) in (0..paths.len() * most).map(|i| (i / most, i % most)) {
        let mut interactions = paths[user].get(k).into_iter().flat_map(|path| path.interactions.iter().rev());
        (0..depth).for_each(|_| {
            points.extend(interactions.next().map_or([f64::NAN; 3], |interaction| interaction.point().to_array()));
        });
    }
    write_npz(&file("inter_pos"), "inter_pos", &[paths.len(), most, depth, 3], &points)
}

/// Returns the interactions of a path, from the base station to the user, as digits of DeepMIMO: 1 to 4 for the kinds of
/// [`scenario_parameters`], in their order.
fn interaction_digits(path: &PropagationPath) -> Vec<usize> {
    let digit = |interaction: &Interaction| match interaction {
        Interaction::Reflection { .. } => 1,
        Interaction::Diffraction { .. } => 2,
        Interaction::Scattering { .. } => 3,
        Interaction::Transmission { .. } => 4,
    };
    path.interactions.iter().rev().map(digit).collect()
}

/// Returns `params.json`. `most` has the largest number of each interaction on a path, in the order of
/// [`interaction_digits`]; `sets` has base stations, then users, with their numbers of points and of active points.
fn scenario_parameters(carrier_hz: f64, most: [usize; 4], sets: [(&str, [usize; 2]); 2]) -> Value {
    let mut ray_tracer = json!({
        "raytracer_name": "pwrfgs", "raytracer_version": env!("CARGO_PKG_VERSION"), "frequency": carrier_hz,
        "max_path_depth": most.iter().sum::<usize>(),
    });
    for (kind, count) in ["reflections", "diffractions", "scattering", "transmissions"].into_iter().zip(most) {
        ray_tracer[format!("max_{kind}")] = count.into();
    }
    let set = |(id, (name, [points, active])): (usize, (&str, [usize; 2]))| {
        let set = json!({
            "name": name, "id": id, "id_orig": id, "is_tx": id == 0, "is_rx": id == 1,
            "num_points": points, "num_active_points": active,
        });
        (format!("txrx_set_{id}"), set)
    };
    json!({
        "version": "4.0.5",
        "rt_params": ray_tracer,
        "scene": {"num_scenes": 1, "n_objects": 0, "n_vertices": 0, "n_faces": 0, "n_triangular_faces": 0},
        "materials": {},
        "txrx_sets": sets.into_iter().enumerate().map(set).collect::<Map<_, _>>(),
    })
}

/// Writes an archive of NumPy with one array of this name, shape and values. Returns an error if the write failed.
fn write_npz(path: &Path, name: &str, shape: &[usize], values: &[f64]) -> Result<()> {
    let write = || {
        let mut archive = ZipWriter::new(File::create(path)?);
        archive.start_file(format!("{name}.npy"), SimpleFileOptions::default())?;
        archive.write_all(&npy_header(Number::F64, shape))?;
        archive.write_all(&values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())?;
        archive.finish()
    };
    write().map(drop).map_err(|e: ZipError| Error::write(path, e.into()))
}

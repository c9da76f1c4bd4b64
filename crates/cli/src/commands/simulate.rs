//! `pwrfgs simulate` and `pwrfgs export-scene`: simulates a data set from a scene, and writes a scene for Sionna RT.

use crate::interrupt::stop_flag;
use crate::output::Verbosity;
use crate::progress::RunProgress;
use clap::{Args, ValueEnum};
use pwrfgs::data::{read_poses, read_transmitters};
use pwrfgs::experiment::run_stage;
use pwrfgs::raytrace::output::{DatasetWriter, OutputLayout, POINTS};
use pwrfgs::raytrace::{ObservationKind, SceneFile, SimulationRecipe, mitsuba};
use pwrfgs::tasks::plane::{parse_pose, parse_position};
use pwrfgs_core::{Error, Result};
use std::path::PathBuf;
use std::time::Instant;

#[derive(Debug, Args)]
#[command(after_help = "\
LAYOUTS
  spectra   NeRF2: gateway_info.yml, spectrum/00001.png, .. (or spectra.npy), power.csv (path gains)
  rssi      NeRF2 BLE: gateway_position.yml, gateway_rssi.csv in dBm, one column per receiver;
            -100.0 means no reception
  channels  channel.npy, complex64 [transmitters, antennas, subcarriers], receiver.yml
  csi       NeRF2 MIMO: csidata.npy, as channel.npy, first half of the subcarriers uplink, second
            half downlink; base-station.yml; NeRF2's program needs 8 antennas and 52 subcarriers
  deepmimo  DeepMIMO v4: params.json and matrices of the 25 strongest paths of each user; receivers
            become base stations, transmitters become users
All layouts except deepmimo have tx_pos.csv, paths.csv, points.ply (surface points with normals),
manifest.json (parameters) and, from five transmitters on, index files (every fifth transmitter is
in the test set). With several receivers, layouts except rssi and deepmimo write one folder per
receiver.
If the receiver moves, rx_pose.csv replaces tx_pos.csv. The layouts are then spectra (with --npy),
rssi and channels, and --no-paths is required.
In a pipeline, `data: Simulated(scene: ..)` simulates the same data without this command.
A Mitsuba XML file of Sionna RT is a scene too. By default, its carrier is 3.5 GHz, and antennas are
at most 1.5 m above its lowest point. For other settings, write a scene file (docs/simulator.md).

EXAMPLES
  pwrfgs simulate office --out data/office
  pwrfgs simulate office --tx-csv walk.csv --layout rssi --no-paths --out data/walk
  pwrfgs simulate scenes/office.ron --samples 100000 --no-paths --npy --out data/many
  pwrfgs simulate scenes/office-links.ron --layout rssi --noise-db 3 --no-paths --out data/rssi
  pwrfgs simulate scene.xml --carrier-hz 28e9 --receiver 0,0,10 --no-paths --out data/canyon
  pwrfgs simulate scenes/office-csi.ron --layout csi --snr-db 30 --no-paths --out data/csi
  pwrfgs simulate scenes/office-channel.ron --layout deepmimo --out deepmimo_scenarios/office")]
pub(crate) struct Simulate {
    /// Scene file, Mitsuba XML file, or name of a scene in `pwrfgs pipelines`
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    /// Layout: spectra, rssi, channels, csi or deepmimo
    #[arg(long, value_enum, hide_possible_values = true, default_value_t = SimulateFormat::Spectra)]
    pub(crate) layout: SimulateFormat,
    /// Carrier in Hz [default: from the scene; 3.5e9 for XML]
    #[arg(long, value_name = "HZ")]
    pub(crate) carrier_hz: Option<f64>,
    /// Position of the (first) receiver in metres [default: from the scene; the middle for XML]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    pub(crate) receiver: Option<String>,
    /// SNR of channels in dB, with --layout channels or csi [default: from the scene]
    #[arg(long, value_name = "DB", allow_negative_numbers = true)]
    pub(crate) snr_db: Option<f64>,
    /// Standard deviation of the error of received powers in dB, for rssi [default: 0]
    #[arg(long, value_name = "DB")]
    pub(crate) noise_db: Option<f64>,
    /// One transmitter position in metres, world frame; with --rx-pose or --rx-pose-csv, the position of the fixed transmitter
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, conflicts_with = "tx_csv")]
    pub(crate) tx: Option<String>,
    /// CSV file of transmitter positions: columns x, y, z in metres; other columns are ignored
    #[arg(long, value_name = "FILE")]
    pub(crate) tx_csv: Option<PathBuf>,
    /// One pose of a moving receiver: position, and orientation as a quaternion from receiver to world axes
    #[arg(long, value_name = "X,Y,Z,QX,QY,QZ,QW", allow_hyphen_values = true, conflicts_with_all = ["tx_csv", "rx_pose_csv"])]
    pub(crate) rx_pose: Option<String>,
    /// CSV file of poses of a moving receiver: columns x, y, z, qx, qy, qz, qw; other columns are ignored
    #[arg(long, value_name = "FILE", conflicts_with = "tx_csv")]
    pub(crate) rx_pose_csv: Option<PathBuf>,
    /// Number of random positions of the transmitter (or moving receiver), unless the scene lists positions [default: 1000]
    #[arg(long, value_name = "N", conflicts_with_all = ["tx", "tx_csv", "rx_pose", "rx_pose_csv"])]
    pub(crate) samples: Option<usize>,
    /// Random seed for transmitter positions and receiver noise
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    pub(crate) seed: u64,
    /// Number of points in the point cloud
    #[arg(long, value_name = "N", default_value_t = 190_000)]
    pub(crate) points: usize,
    /// Write spectra.npy instead of images; required from 100,000 spectra
    #[arg(long)]
    pub(crate) npy: bool,
    /// Do not write paths.csv, which has one row per path: hundreds per transmitter with rough surfaces
    #[arg(long)]
    pub(crate) no_paths: bool,
}

/// Layout of the simulated data set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum SimulateFormat {
    /// Spatial spectra
    Spectra,
    /// Received powers in NeRF2's BLE layout
    Rssi,
    /// Channels in one array
    Channels,
    /// Uplink and downlink channels in NeRF2's MIMO layout
    Csi,
    /// Paths as a scenario of DeepMIMO v4
    Deepmimo,
}

impl Simulate {
    /// Returns the scene with the stated positions of transmitters, or poses of its receiver, if any.
    fn with_positions(&self, scene: SceneFile) -> Result<SceneFile> {
        let tx = self.tx.as_deref().map(|text| parse_position("--tx", text)).transpose()?;
        match (tx, &self.tx_csv, &self.rx_pose, &self.rx_pose_csv) {
            (_, _, Some(text), _) => scene.with_receiver_poses(vec![parse_pose("--rx-pose", text)?], tx),
            (_, _, _, Some(file)) => scene.with_receiver_poses(read_poses(file)?, tx),
            (_, Some(file), ..) => scene.with_transmitters(read_transmitters(file)?),
            (Some(tx), ..) => scene.with_transmitters(vec![tx]),
            _ => Ok(scene),
        }
    }

    /// Returns the kind of observation and the layout of its files; an option that the layout does not support is an
    /// error.
    fn resolve_layout(&self) -> Result<(ObservationKind, OutputLayout)> {
        let refuse = |problem: &str| Err(Error::Config(problem.into()));
        let is_channel = matches!(self.layout, SimulateFormat::Channels | SimulateFormat::Csi);
        if self.npy && self.layout != SimulateFormat::Spectra {
            return refuse("--npy: supported only for spectra; remove --npy or --layout");
        }
        if self.snr_db.is_some() && !is_channel {
            return refuse(
                "--snr-db: supported only for channels; add --layout channels, or set `noise` in the scene for spectra",
            );
        }
        if self.noise_db.is_some() && self.layout != SimulateFormat::Rssi {
            return refuse("--noise-db: supported only for received powers; add --layout rssi");
        }
        if self.no_paths && self.layout == SimulateFormat::Deepmimo {
            return refuse("--no-paths: the layout deepmimo consists of paths; remove --no-paths");
        }
        let channel = ObservationKind::Channel { snr_db: self.snr_db };
        Ok(match self.layout {
            SimulateFormat::Spectra if self.npy => (ObservationKind::Spectrum, OutputLayout::Array),
            SimulateFormat::Spectra => (ObservationKind::Spectrum, OutputLayout::Images),
            SimulateFormat::Rssi => {
                (ObservationKind::Power { noise_db: self.noise_db.unwrap_or(0.0) }, OutputLayout::Rssi)
            }
            SimulateFormat::Channels => (channel, OutputLayout::Channels),
            SimulateFormat::Csi => (channel, OutputLayout::Csi),
            SimulateFormat::Deepmimo => (channel, OutputLayout::DeepMimo),
        })
    }
}

#[derive(Debug, Args)]
#[command(after_help = "\
The folder contains scene.xml and meshes/*.ply: a mesh per object, and meshes of walls, floor and
ceiling. Sheets (with `thickness_m`) keep material and thickness; solids (without it) become sheets
with a thickness of 10 m. Antennas are not written: set them in Python (Sionna RT).

EXAMPLES
  pwrfgs export-scene scenes/conference.ron --out conference
  pwrfgs simulate conference/scene.xml --receiver 0.3,3,2.4 --out data/conference")]
pub(crate) struct ExportScene {
    /// Scene file, or name of a scene in `pwrfgs pipelines`
    #[arg(value_name = "SCENE")]
    pub(crate) scene: PathBuf,
    /// Output folder; must be new or empty
    #[arg(short, long, value_name = "DIR")]
    pub(crate) out: PathBuf,
}

/// Runs `pwrfgs export-scene`: writes the scene as Mitsuba XML with meshes.
pub(crate) fn export_scene(arguments: &ExportScene, verbosity: Verbosity) -> Result<()> {
    let scene = SceneFile::read(&arguments.scene)?;
    let (meshes, out) = (mitsuba::export_scene(&scene, &arguments.out)?, arguments.out.display());
    let how = format!("`simulate --carrier-hz {:e}` or sionna.rt.load_scene", scene.carrier_hz);
    verbosity.print_note(&format!("{meshes} meshes in {out}; read scene.xml with {how}"));
    Ok(())
}

/// Runs `pwrfgs simulate`: writes the simulated data set.
pub(crate) fn simulate(arguments: &Simulate, verbosity: Verbosity) -> Result<()> {
    let begun = Instant::now();
    let stop = stop_flag();
    let (observe, layout) = arguments.resolve_layout()?;
    let receiver = arguments.receiver.as_deref().map(|text| parse_position("--receiver", text)).transpose()?;
    let samples = arguments.samples.unwrap_or(1000);
    let recipe = SimulationRecipe::read(&arguments.scene, samples, arguments.seed, arguments.points)?;
    if arguments.samples.is_some_and(|samples| samples != recipe.samples) {
        let count = recipe.samples;
        return Err(Error::Config(format!("--samples: the scene states {count} positions; remove --samples")));
    }
    let scene = recipe.scene.clone().with_overrides(arguments.carrier_hz, receiver)?;
    let recipe = recipe.with_scene(arguments.with_positions(scene)?)?.observing(observe)?;
    if arguments.scene.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("xml")) {
        let (scene, (low, high)) = (&recipe.scene, recipe.scene.transmitter.positions.corners());
        let (n, hz, at) = (scene.objects.len(), scene.carrier_hz, scene.receiver.position);
        let region = format!("transmitters from {low:?} to {high:?}");
        verbosity.print_note(&format!("{n} meshes; carrier {hz:e} Hz, receiver at {at:?}, {region}"));
    }
    RunProgress::observe(verbosity, |progress| {
        run_stage(progress, "simulating", |progress| {
            DatasetWriter { layout, has_paths: !arguments.no_paths, progress, stop: &stop }
                .write(&recipe, &arguments.out)
        })
    })?;
    verbosity.print_note(&describe_data(arguments, &recipe, layout, begun.elapsed().as_secs_f64()));
    Ok(())
}

/// Describes the simulated data set, and how to read it: the setting of a pipeline, or a call in Python.
fn describe_data(arguments: &Simulate, recipe: &SimulationRecipe, layout: OutputLayout, seconds: f64) -> String {
    let (scene, out) = (&recipe.scene, arguments.out.display());
    let receivers = scene.receivers().count();
    let has_one_folder = receivers == 1 || layout == OutputLayout::Rssi;
    // Several receivers have a folder each; the first is shown.
    let root = if has_one_folder { arguments.out.clone() } else { arguments.out.join(&scene.receiver.name) };
    let carriers = scene.carriers_hz.len().max(1);
    let count = recipe.samples * receivers * carriers;
    let ends = match (receivers, carriers) {
        (1, 1) => String::new(),
        (1, _) => format!(" at {carriers} carriers"),
        _ => format!(" at {receivers} receivers"),
    };
    let plain = |plugin: &str| format!("{plugin}(root: \"{}\")", root.display());
    let with_points = |plugin: &str| {
        let points = root.join(POINTS);
        format!("{plugin}(root: \"{}\", points: \"{}\")", root.display(), points.display())
    };
    let (things, plugin) = match layout {
        OutputLayout::Images => ("spectra", with_points("Nerf2Spectrum")),
        OutputLayout::Array => ("spectra", with_points("Arrays")),
        OutputLayout::Rssi => ("powers", plain("Nerf2Rssi")),
        OutputLayout::Channels => ("channels", plain("Channels")),
        OutputLayout::Csi => {
            let spacing = scene.subcarriers.as_ref().map_or(0.0, |band| band.spacing_hz());
            let (root, carrier) = (root.display(), scene.carrier_hz);
            let (plugin, band) = ("Nerf2Csi", format!("carrier_hz: {carrier:?}, spacing_hz: {spacing:?}"));
            ("channels", format!("{plugin}(root: \"{root}\", {band}, together: true)"))
        }
        OutputLayout::DeepMimo => {
            let pair = if receivers == 1 { "" } else { ", pair=(0, 0, 1)" };
            let (users, name) = (recipe.samples, &scene.name);
            let text = format!("{users} simulated users of {name}{ends} in {out} after {seconds:.1} s");
            return format!("{text}; in Python: pwrfgs.convert.from_deepmimo(\"{out}\"{pair})");
        }
    };
    format!(
        "{count} simulated {things} of {}{ends} in {out} after {seconds:.1} s; in a pipeline: data: {plugin}",
        scene.name
    )
}

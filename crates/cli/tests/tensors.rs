//! The tables of tensors in `docs/model-format.md`, made from files of every kind.
//!
//! `PWRFGS_PAGES=write cargo test -p pwrfgs-cli --test cli -- tensors::` prints them into the page.

use crate::common::small_run;
use crate::model_format::{models, virtual_transmitters};
use crate::versions::folder;
use pwrfgs::model::{Ensemble, Model, Stages, compress, export, file};
use pwrfgs_core::{ImagePlane, MeasurementSetup, Method, Origin, Plugin, Pose, Receiver, Task, rng};
use regex::Regex;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Name, shape and meaning of a tensor; a row without meaning is not printed. `<..>` stands for any name. A capital letter has one value per file; a word in
/// small letters has any.
type Row = (&'static str, &'static str, &'static str);

const MODEL: &[Row] = &[
    ("gaussians.means", "N, 3", "centres μ, metres from `origin`"),
    ("gaussians.log_scales", "N, 3", "natural logarithms of the scales in metres"),
    ("gaussians.quats", "N, 4", "rotations w, x, y, z, not normalised"),
    ("gaussians.opacity_logits", "N, 1", "the opacity is 1/(1 + exp(-logit))"),
    ("gaussians.signals", "N, 2", "two real channels of the signal"),
    (
        "gaussians.harmonics",
        "N, H",
        "`VirtualTransmitters(order: L)`: real and imaginary parts of H/2 = (L + 1)² − 1 gains",
    ),
    ("network.<layer>.weight", "out, in", "as in a PyTorch `Linear`"),
    ("network.<layer>.weight.scales", "out", "for weights of type I8: factor of each row"),
    ("network.<layer>.bias", "out", "absent for the layer `near`"),
    ("network.near.positions", "n, 3", "`Factored(near: ..)`: training positions, metres from `origin`"),
    ("network.receiver.offsets", "R", "offset of each receiver, bel (powers and `SplattedChannel`)"),
    ("network.receiver.exponents", "R", "path-loss exponent of each receiver (powers)"),
    ("constants.<field>", "count, 3", "wave vectors of `Waves` and `Wavelengths`, rad/m; may be absent"),
    ("training_positions", "K, 3", "thinned training positions, metres from `origin`; may be absent"),
    ("residuals.places", "L, 3", "transmitters of the known links of all receivers, metres from `origin`"),
    ("residuals.values", "L, V", "residuals of V stored values per link; I8 if `stride` is above 1"),
    ("residuals.units", "L", "value of 1 in `residuals.values`; absent if `stride` is 1"),
    ("calibration.blocks", "1", "number of blocks"),
    ("calibration.values", "S, 2", "ascending scores of values, and the share of scores up to each"),
    ("calibration.ssim", "Q, 2", "the same for the SSIM; only for spectra"),
];

const NPZ: &[Row] = &[
    ("means", "N, 3", "centres, metres, world frame; float64 with an `origin`"),
    ("log_scales", "N, 3", ""),
    ("quats", "N, 4", ""),
    ("opacity_logits", "N", ""),
    ("signals", "N, 2", ""),
    ("harmonics", "N, H", ""),
    ("network.<layer>.weight", "out, in", ""),
    ("network.<layer>.bias", "out", ""),
    ("network.near.positions", "n, 3", ""),
    ("network.receiver.offsets", "R", ""),
    ("network.receiver.exponents", "R", ""),
    ("constants.<field>", "count, 3", ""),
    ("origin", "3", "metres; absent if zero"),
    ("pose.position", "3", "first receiver, metres"),
    ("pose.orientation", "4", "quaternion x, y, z, w"),
    ("plane.size", "2", "width and height, pixels"),
    ("plane.wraps", "", "whether the last column is adjacent to the first"),
    ("plane.azimuth_deg", "2", "degrees at pixel 0, degrees per pixel; absent if pixels are not angles"),
    ("plane.elevation_deg", "2", "as the azimuth"),
    ("kind", "letters", "`spectrum`, `power` or `channel` as bytes †"),
    ("receivers.names", "letters", "all names as bytes, separated by line feeds †"),
    ("receivers.positions", "R, 3", "metres, world frame †"),
    ("receivers.orientations", "R, 4", "quaternions x, y, z, w †"),
    ("receivers.antenna_counts", "R", "antennas per receiver †"),
    ("receivers.antennas", "A, 3", "antennas of all receivers, metres, receiver frame †"),
    ("frequencies_hz", "F", "subcarriers; only for channels"),
    ("tx.position", "3", "with `--tx`: metres, world frame; float64 with an `origin`"),
    ("tx.scales", "N, 3", "with `--tx`: metres"),
    ("tx.quats", "N, 4", "with `--tx`: w, x, y, z"),
    ("tx.opacities", "N", "with `--tx`: from 0 to 1"),
    ("tx.signals", "N, channels", "with `--tx`: blended signals"),
];

const CHECKPOINT: &[Row] = &[
    ("value.<column>", "N, width", "columns of the Gaussians, also those of pruners"),
    ("first.<column>", "N, width", "first moments of Adam"),
    ("second.<column>", "N, width", "second moments of Adam"),
    ("value.network.<tensor>", "..", "network, as in the model file"),
    ("first.network.<tensor>", "..", "first moments of Adam"),
    ("second.network.<tensor>", "..", "second moments of Adam"),
    ("stats.<statistic>", "N", "statistics since the last densification"),
    ("gaussian_ids", "N", "persistent ID of each Gaussian"),
];

const SNAPSHOT: &[Row] = &[
    ("means", "N, 3", "centres, metres from `origin`"),
    ("opacities", "N", "opacities without the gates of pruners"),
    ("scales", "N, 3", "metres, without the terms of a transmitter"),
    ("quats", "N, 4", "w, x, y, z as learned"),
    ("gaussian_ids", "N", "persistent ID, equal in all snapshots; a copy of a Gaussian gets a new ID"),
    ("gates", "N, 1", "gates of the pruners, from 0 (closed) to 1; absent without gates"),
];

/// Layers of a network with the defaults of its plugin, and the input of each.
const NETWORKS: [(&str, &[(&str, &str)]); 4] = [
    (
        "Splatting(deformation: Mlp(), readout: ReceivedPower())",
        &[
            (r"tx\.0", "p in octaves, carrier"),
            (r"tx\.1", "`tx.0`; gives the features e"),
            (r"trunk\.0", "μ in octaves, e"),
            (r"trunk\.5", "μ in octaves, e, `trunk.4` (`skip: 4`)"),
            (r"trunk\.[1-46-9]", "previous layer"),
            ("rotation", "last `trunk`; gives ΔR"),
            ("scaling", "last `trunk`; gives ΔS"),
            ("signal", "last `trunk`; gives Δs"),
        ],
    ),
    (
        "Splatting(deformation: Factored(near: (count: 512, length_m: 1)))",
        &[
            (r"tx\.0", "p in `tx_encoding`, carrier"),
            (r"tx\.[1-9]", "previous layer; the last gives T"),
            ("branch", "scaled waves of μ; gives factors of T and constants, real part first"),
            ("near", "scaled waves of μ, for the correlations with `network.near.positions`"),
        ],
    ),
    (
        "Splatting(deformation: Wrfgs(), projector: WrfgsCompat(), calibration: AsReleased, readout: Real)",
        &[
            (r"trunk\.0", "μ in octaves"),
            (r"trunk\.5", "μ in octaves, `trunk.4` (`skip: 4`)"),
            (r"trunk\.[1-46-9]", "previous layer"),
            ("attn", "last `trunk`; gives amplitude A"),
            ("feat", "last `trunk`; gives the features f"),
            (r"sig\.0", "f, p in octaves, μ − p in octaves"),
            (r"sig\.1", "`sig.0`"),
            ("out", "`sig.1`; gives amplitude S"),
        ],
    ),
    (
        "Nerf2()",
        &[
            (r"trunk\.0", "position of a sample in octaves"),
            (r"trunk\.5", "position in octaves, `trunk.4`"),
            (r"trunk\.[1-46-9]", "previous layer"),
            ("attenuation", "last `trunk`; amplitudes, then phases"),
            ("feature", "last `trunk`"),
            (r"signal\.0", "`feature`, direction in octaves, p in octaves"),
            (r"signal\.1", "`signal.0`"),
            ("emission", "`signal.1`; amplitudes, then phases"),
        ],
    ),
];

/// Tensors of a file: name, sizes, type.
type Listed = Vec<(String, Vec<usize>, String)>;

/// Lists the tensors of a safetensors file.
fn listed(bytes: &[u8]) -> Listed {
    let length = u64::from_le_bytes(bytes[..8].try_into().unwrap()) as usize;
    let header: serde_json::Map<String, serde_json::Value> = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
    let sizes = |tensor: &serde_json::Value| serde_json::from_value(tensor["shape"].clone()).unwrap();
    let tensors = header.iter().filter(|(name, _)| *name != "__metadata__");
    tensors.map(|(name, tensor)| (name.clone(), sizes(tensor), tensor["dtype"].as_str().unwrap().into())).collect()
}

/// Lists the arrays of an NPZ file.
fn arrays(bytes: Vec<u8>) -> Listed {
    let mut archive = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let names: Vec<String> = archive.file_names().map(|name| name.unwrap().into_owned()).collect();
    let read = |name: String| {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut archive.by_name(&name).unwrap(), &mut bytes).unwrap();
        let kinds = [("<f4", "float32"), ("<f8", "float64"), ("<u8", "uint64"), ("|u1", "uint8"), ("|b1", "bool")];
        let header = String::from_utf8_lossy(&bytes[..bytes.len().min(120)]).into_owned();
        let kind = kinds.iter().find(|(descr, _)| header.contains(&format!("'{descr}'"))).unwrap().1;
        (name.strip_suffix(".npy").unwrap().to_owned(), pwrfgs_core::testing::npy(&bytes).0, kind.to_owned())
    };
    names.into_iter().map(read).collect()
}

/// A table of tensors with the types that occur in files.
struct Table {
    rows: &'static [Row],
    names: Vec<Regex>,
    types: Vec<BTreeSet<String>>,
}

impl Table {
    fn new(rows: &'static [Row]) -> Self {
        let pattern = |name: &str| {
            let name = name.replace('.', r"\.");
            let name = name.replace("<layer>", r"[a-z0-9_.]+").replace("<tensor>", ".+");
            Regex::new(&format!("^{}$", Regex::new("<[a-z]+>").unwrap().replace_all(&name, "[a-z_]+"))).unwrap()
        };
        Self { rows, names: rows.iter().map(|row| pattern(row.0)).collect(), types: vec![BTreeSet::new(); rows.len()] }
    }

    /// Finds the row of each tensor of a file, and checks its shape.
    ///
    /// # Panics
    /// A tensor has no row, or another shape than its row.
    fn add(&mut self, file: &str, tensors: Listed) {
        let prefix = Regex::new(r"^members\.\d+\.").unwrap();
        let mut sizes = BTreeMap::new();
        for (whole, shape, kind) in tensors {
            let member = prefix.find(&whole).map_or("", |found| found.as_str()).to_owned();
            let name = &whole[member.len()..];
            let row = self
                .names
                .iter()
                .position(|row| row.is_match(name))
                .unwrap_or_else(|| panic!("{file}: no row for {whole}"));
            let axes: Vec<&str> = self.rows[row].1.split(", ").filter(|axis| !axis.is_empty()).collect();
            let is_size = |(axis, size): (&&str, &usize)| match axis.parse::<usize>() {
                Ok(number) => number == *size,
                Err(_) if axis.starts_with(char::is_uppercase) => {
                    *sizes.entry((member.clone(), (*axis).to_owned())).or_insert(*size) == *size
                }
                Err(_) => true,
            };
            let fits = axes == [".."] || axes.len() == shape.len() && axes.iter().zip(&shape).all(is_size);
            assert!(fits, "{file}: {whole} has the shape {shape:?}, and its row [{}]", self.rows[row].1);
            self.types[row].insert(kind);
        }
    }

    /// Prints the table. Rows in sequence that share shape, type and meaning are one row.
    ///
    /// # Panics
    /// No file has the tensor of a row.
    fn print(&self, what: &str) -> String {
        let mut rows: Vec<(String, String)> = Vec::new();
        for ((name, shape, meaning), types) in self.rows.iter().zip(&self.types) {
            assert!(!types.is_empty(), "no file has `{name}`");
            if meaning.is_empty() {
                continue;
            }
            let mut types: Vec<&str> = types.iter().map(String::as_str).collect();
            types.sort_by_key(|kind| !kind.contains("32"));
            let end = format!("[{shape}] | {} | {meaning} |", types.join(", "));
            match rows.last_mut().filter(|(_, last)| *last == end) {
                Some((names, _)) => *names = format!("{names}, `{name}`"),
                None => rows.push((format!("`{name}`"), end)),
            }
        }
        let rows: Vec<String> = rows.into_iter().map(|(name, end)| format!("| {name} | {end}\n")).collect();
        let rows = rows.concat();
        format!("| {what} | shape | type | meaning |\n|---|---|---|---|\n{rows}")
    }
}

/// A model of one receiver with this method, for received powers or channels of one subcarrier.
fn one_receiver(method: &str, task: Task) -> Model {
    let method: Plugin<dyn Method> = Plugin::parse(method).unwrap_or_else(|e| panic!("{method}: {e}"));
    let (plane, frequencies_hz) = match task {
        Task::Channel => (ImagePlane::plain(1, 2), vec![0.9e9]),
        _ => (ImagePlane::plain(1, 1), Vec::new()),
    };
    let receivers = vec![Receiver { antennas: vec![[0.0; 3]], ..Receiver::new("hall", Pose::IDENTITY) }];
    let spectra = MeasurementSetup::spectra(Origin::ZERO, Pose::IDENTITY, plane);
    let stages = Stages { method, setup: MeasurementSetup { receivers, task, frequencies_hz, ..spectra } };
    let weights = stages.layout().init(&mut rng::stream(1, "weights", 0));
    Model { stages, weights, ..models().next().unwrap() }
}

/// Tables of the tensors of all files.
fn tables() -> String {
    let [mut model, mut npz, mut checkpoint, mut snapshot] = [MODEL, NPZ, CHECKPOINT, SNAPSHOT].map(Table::new);
    let power = "Splatting(deformation: Fixed(), readout: ReceivedPower(sky_deg: 30))";
    let more = [
        virtual_transmitters(2),
        one_receiver(power, Task::Power),
        one_receiver("SplattedChannel(deformation: Fixed())", Task::Channel),
        one_receiver("Nerf2(width: 8)", Task::Power),
    ];
    for (k, mut one) in models().chain(more).enumerate() {
        one.stages.origin = Origin(if k % 2 == 0 { [0.0; 3] } else { [5e5, 54e5, -1e2] });
        let ensemble = Ensemble::of(one);
        model.add(&format!("model {k}"), listed(&file::ensemble_to_bytes(&ensemble)));
        if let Ok(small) = compress::to_bytes(&ensemble, compress::Bits::Eight) {
            model.add(&format!("compressed model {k}"), listed(&small));
        }
        let has_gaussians = ensemble.members()[0].stages.method.traits().has_gaussians();
        let tx = (has_gaussians && ensemble.members()[0].stages.task.has_pixels).then_some([0.3, 0.5, 1.0]);
        npz.add(&format!("export of model {k}"), arrays(export::npz(&ensemble, tx).unwrap()));
    }
    let committed = ["residuals", "powers"].map(|name| folder().join(format!("{name}.safetensors")));
    for path in committed.into_iter().chain([small_run().join("run/model.safetensors")]) {
        let ensemble = file::read_ensemble(&path).unwrap();
        let half = file::to_bytes_half(&ensemble).unwrap();
        [std::fs::read(&path).unwrap(), half]
            .iter()
            .for_each(|bytes| model.add(&path.display().to_string(), listed(bytes)));
    }
    let read = |name: &str| listed(&std::fs::read(small_run().join("run").join(name)).unwrap());
    checkpoint.add("checkpoint", read("checkpoint.safetensors"));
    snapshot.add("snapshot", read("start.safetensors"));
    format!(
        "{}\n{}\n{}\n{}\n{}",
        model.print("tensor of a model file"),
        networks(),
        npz.print("array of `export --npz`"),
        checkpoint.print("tensor of `checkpoint.safetensors`"),
        snapshot.print("tensor of a snapshot")
    )
}

/// Table of the layers of each network. Layers in sequence that share shape and input are one row.
fn networks() -> String {
    let mut table = vec!["| network | layer | weight | input |\n|---|---|---|---|\n".to_owned()];
    let plugin = Regex::new(r"(\w+)\((near: .*)?\)").unwrap();
    for (method, texts) in NETWORKS {
        let name = plugin.captures(method).unwrap()[1].to_owned();
        let mut rows: Vec<(Vec<String>, Vec<usize>, &str)> = Vec::new();
        for spec in one_receiver(method, Task::Power).stages.layout().weights {
            let Some(layer) = spec.name.strip_suffix(".weight") else { continue };
            let is_text = |(name, _): &&(&str, &str)| Regex::new(&format!("^{name}$")).unwrap().is_match(layer);
            let found: Vec<_> = texts.iter().filter(is_text).collect();
            let [&(_, text)] = found[..] else { panic!("the layer {layer} of {name} has the texts {found:?}") };
            match rows.last_mut().filter(|row| (&row.1, row.2) == (&spec.shape, text)) {
                Some(row) => row.0.push(format!("`{layer}`")),
                None => rows.push((vec![format!("`{layer}`")], spec.shape.clone(), text)),
            }
        }
        let unused = texts.iter().find(|(_, text)| !rows.iter().any(|row| row.2 == *text));
        assert!(unused.is_none(), "{name} has no layer {unused:?}");
        for (layers, shape, text) in rows {
            let ends = [layers.first(), layers.last().filter(|_| layers.len() > 1)].into_iter().flatten();
            let layers = ends.cloned().collect::<Vec<_>>().join(" to ");
            table.push(format!("| `{name}` | {layers} | {shape:?} | {text} |\n"));
        }
    }
    table.concat()
}

#[test]
fn page_lists_the_tensors_of_every_file() {
    if cfg!(feature = "f64") {
        return; // other types
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/model-format.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (start, end) = ("<!-- tables of crates/cli/tests/tensors.rs -->\n", "<!-- end of tables -->\n");
    let (before, rest) = page.split_once(start).unwrap();
    let (old, after) = rest.split_once(end).unwrap();
    let new = tables();
    if std::env::var("PWRFGS_PAGES").is_ok_and(|value| value == "write") {
        std::fs::write(&path, [before, start, &new, end, after].concat()).unwrap();
    } else {
        assert_eq!(old, new, "docs/model-format.md is not up to date; PWRFGS_PAGES=write prints the tables into it");
    }
}

/// Checks that the tables have a row for each tensor of a model file.
pub(crate) fn check_listed(file: &str, bytes: &[u8]) {
    Table::new(MODEL).add(file, listed(bytes));
}

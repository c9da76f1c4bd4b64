//! Golden test: eight short runs give the content that `golden/expected.txt` records.
//!
//! The file holds one line per tensor of models and checkpoints and one per group of numbers in `scores.csv` and
//! `samples.csv`: name, SHA-256 of the values, count, mean and root mean square. Headers, notes, fingerprints and names of
//! columns are not compared. On a processor or C library other than the recorded ones, means and root mean squares are
//! compared to 1e-4 instead of digests.
//!
//! If a change alters stored values on purpose, run this test with `PWRFGS_GOLDEN=write` and say why in the commit.

#![cfg(all(feature = "raytrace", not(feature = "f64")))]

use crate::common::{succeed, write};
use pwrfgs_core::files::digest;
use pwrfgs_core::testing::skipped;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

const RUNS: [&str; 8] = ["array", "channel", "joined", "nerf2", "powers", "quickstart", "uplink", "wrfgs"];
const TOLERANCE: f64 = 1e-4;
/// Smallest root mean square to which the tolerance is relative: derivatives of rotations of spheres are rounding errors
/// of up to 5e-10.
const FLOOR: f64 = 1e-5;

/// One tensor, or one group of numbers of a table.
#[derive(Debug, PartialEq)]
struct Content {
    name: String,
    digest: String,
    count: usize,
    mean: f64,
    rms: f64,
}

impl Content {
    fn of(name: String, values: &[f64]) -> Self {
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let mean_of = |f: fn(f64) -> f64| values.iter().map(|v| f(*v)).sum::<f64>() / values.len().max(1) as f64;
        let digest = digest(&bytes)[..16].to_owned();
        Self { name, digest, count: values.len(), mean: mean_of(|v| v), rms: mean_of(|v| v * v).sqrt() }
    }

    fn line(&self) -> String {
        let Self { name, digest, count, mean, rms } = self;
        format!("{name} {digest} {count} {mean:e} {rms:e}")
    }

    fn parse(line: &str) -> Self {
        let [name, digest, count, mean, rms] = line.split(' ').collect::<Vec<_>>().try_into().unwrap();
        let number = |text: &str| text.parse().unwrap();
        Self {
            name: name.into(),
            digest: digest.into(),
            count: count.parse().unwrap(),
            mean: number(mean),
            rms: number(rms),
        }
    }

    /// Whether two machines may differ so.
    fn is_near(&self, other: &Self) -> bool {
        let near = |a: f64, b: f64| (a - b).abs() <= TOLERANCE * other.rms.max(FLOOR);
        self.name == other.name && self.count == other.count && near(self.mean, other.mean) && near(self.rms, other.rms)
    }
}

/// Tensors of a safetensors file of 32-bit numbers and identifiers, by name.
fn tensors(path: &Path, label: &str) -> Vec<Content> {
    let bytes = std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (length, rest) = bytes.split_first_chunk().unwrap();
    let (header, data) = rest.split_at(u64::from_le_bytes(*length) as usize);
    let mut header: BTreeMap<String, serde_json::Value> = serde_json::from_slice(header).unwrap();
    header.remove("__metadata__");
    let content = header.into_iter().map(|(name, entry)| {
        let number = |bytes: &[u8; 4]| match entry["dtype"].as_str() {
            Some("U32") => f64::from(u32::from_le_bytes(*bytes)),
            dtype => {
                assert_eq!(dtype, Some("F32"), "{name}");
                f64::from(f32::from_le_bytes(*bytes))
            }
        };
        let [from, to] = [0, 1].map(|k| entry["data_offsets"][k].as_u64().unwrap() as usize);
        let values: Vec<f64> = data[from..to].as_chunks().0.iter().map(number).collect();
        let shape = entry["shape"].to_string();
        Content::of(format!("{label}/{name}{shape}"), &values)
    });
    content.collect()
}

/// The numbers of a table, one group per run of rows with equal words.
fn numbers(path: &Path, label: &str) -> Vec<Content> {
    let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let mut groups: Vec<(Vec<&str>, Vec<f64>)> = Vec::new();
    for row in text.lines().skip(1) {
        let words: Vec<&str> = row.split(',').filter(|cell| cell.parse::<f64>().is_err()).collect();
        if groups.last().is_none_or(|(of, _)| *of != words) {
            groups.push((words, Vec::new()));
        }
        groups.last_mut().unwrap().1.extend(row.split(',').filter_map(|cell| cell.parse::<f64>().ok()));
    }
    groups.iter().enumerate().map(|(k, (_, values))| Content::of(format!("{label}/{k}"), values)).collect()
}

/// Files of this name in a folder and the folders below it, sorted.
fn files_below(folder: &Path, name: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(files_below(&path, name));
        } else if path.ends_with(name) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Channels of 40 positions at 2 antennas and 8 subcarriers, without a function whose last bit depends on a library.
fn write_channels(folder: &Path) {
    let value = |i: usize| ((i * i * 7 + i * 31) % 997) as f32 / 997.0 - 0.5;
    let header = "{'descr': '<c8', 'fortran_order': False, 'shape': (40, 2, 8), }";
    let mut bytes = b"\x93NUMPY\x01\x00\x76\x00".to_vec();
    bytes.extend(format!("{header:<117}\n").bytes());
    bytes.extend((0..2 * 40 * 2 * 8).flat_map(|i| value(i).to_le_bytes()));
    write(&folder.join("csidata.npy"), bytes);
    write(&folder.join("base-station.yml"), "base_station: [[0.0, 0.0, 0.0], [0.06, 0.0, 0.0]]\n");
    let mut table = "x,y,z\n".to_owned();
    for k in 0..40 {
        writeln!(
            table,
            "{},{},{}",
            1.0 + (k * 7 % 40) as f64 / 16.0,
            (k * 11 % 40) as f64 / 16.0,
            1.0 + (k % 5) as f64
        )
        .unwrap();
    }
    write(&folder.join("tx.csv"), table);
}

/// The content of all runs.
fn run_all(here: &Path) -> Vec<Content> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    for name in RUNS {
        let text = std::fs::read_to_string(root.join(format!("tests/golden/{name}.ron"))).unwrap();
        let scenes = root.join("../../scenes");
        write(&here.join(format!("{name}.ron")), text.replace("SCENES", scenes.to_str().unwrap()));
    }
    write_channels(&here.join("csi"));
    let mut all = Vec::new();
    for name in RUNS {
        let command = if name == "joined" { "sweep" } else { "run" };
        succeed(here, &[command, &format!("{name}.ron"), "--out", name, "-q", "--keep-checkpoint"]);
        let folder = here.join(name);
        let scored = if name == "joined" { folder.join("joined") } else { folder.clone() };
        all.extend(tensors(&scored.join("model.safetensors"), &format!("{name}/model")));
        for (k, path) in files_below(&folder, "checkpoint.safetensors").iter().enumerate() {
            all.extend(tensors(path, &format!("{name}/checkpoint-{k}")));
        }
        all.extend(numbers(&scored.join("scores.csv"), &format!("{name}/scores")));
        all.extend(numbers(&scored.join("samples.csv"), &format!("{name}/samples")));
    }
    all
}

/// What the last bits depend on: the vector instructions of the processor, and the C library.
fn machine() -> String {
    #[cfg(target_arch = "x86_64")]
    let features = [
        ("avx2", is_x86_feature_detected!("avx2")),
        ("fma", is_x86_feature_detected!("fma")),
        ("avx512f", is_x86_feature_detected!("avx512f")),
        ("avx512bw", is_x86_feature_detected!("avx512bw")),
        ("avx512dq", is_x86_feature_detected!("avx512dq")),
        ("avx512vl", is_x86_feature_detected!("avx512vl")),
    ];
    #[cfg(not(target_arch = "x86_64"))]
    let features = [("unknown", true)];
    let features: Vec<&str> = features.iter().filter(|(_, has)| *has).map(|(name, _)| *name).collect();
    let library = Command::new("getconf").arg("GNU_LIBC_VERSION").output();
    let library =
        library.map_or("an unknown C library".into(), |o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
    format!("{} with {}, {library}", std::env::consts::ARCH, features.join(" "))
}

#[test]
fn eight_runs_reproduce_recorded_content() {
    let folder = tempfile::tempdir().unwrap();
    let found = run_all(folder.path());
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/expected.txt");
    if std::env::var_os("PWRFGS_GOLDEN").is_some_and(|what| what == "write") {
        let lines: Vec<String> = found.iter().map(Content::line).collect();
        std::fs::write(&path, format!("{}\n{}\n", machine(), lines.join("\n"))).unwrap();
        return;
    }
    let text = std::fs::read_to_string(&path).unwrap();
    let (recorded_on, lines) = text.split_once('\n').unwrap();
    let expected: Vec<Content> = lines.lines().map(Content::parse).collect();
    let exact = recorded_on == machine();
    if !exact {
        skipped(&format!(
            "the golden test compared numbers to {TOLERANCE:e}, not bits: recorded on {recorded_on}, run on {}",
            machine()
        ));
    }
    assert_eq!(found.len(), expected.len(), "tensors and groups of numbers");
    let differs = |(found, expected): &(&Content, &Content)| {
        if exact {
            (&found.name, &found.digest) != (&expected.name, &expected.digest)
        } else {
            !found.is_near(expected)
        }
    };
    let differing: Vec<String> = found
        .iter()
        .zip(&expected)
        .filter(differs)
        .map(|(found, expected)| format!("found    {}\nexpected {}", found.line(), expected.line()))
        .collect();
    assert!(differing.is_empty(), "{} of {} differ:\n{}", differing.len(), found.len(), differing.join("\n"));
}

#[test]
fn comparison_finds_changed_bit_and_changed_shape() {
    let one = Content::of("a[2]".into(), &[1.0, 2.0]);
    let bit = Content::of("a[2]".into(), &[1.0, 2.0 + f64::EPSILON * 2.0]);
    assert!(one.digest != bit.digest && one.is_near(&bit));
    assert!(!one.is_near(&Content::of("a[2]".into(), &[1.0, 2.001])));
    assert!(!one.is_near(&Content::of("a[1,2]".into(), &[1.0, 2.0])));
    assert_eq!(Content::parse(&one.line()), one);
}

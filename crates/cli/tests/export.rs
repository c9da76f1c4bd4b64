//! Exports against the model and its predictions.
use crate::common::{SMALL, copy_small_run, refuse, succeed, write};
use pwrfgs::data::read_points;
use pwrfgs::model::{Model, file};
use pwrfgs_core::testing::npy;
use pwrfgs_core::{Activated, DeformationInputs, Real, sigmoid};
use std::collections::BTreeMap;
use std::path::Path;

const MODEL: &str = "r/model.safetensors";
const TX: [f64; 3] = [0.3, -0.25, 1.5];

/// A trained model in the folder `r`.
fn trained(here: &Path, settings: &[&str]) -> Model {
    if settings.is_empty() {
        copy_small_run(here, "r");
    } else {
        write(&here.join("p.ron"), SMALL);
        let set: Vec<&str> = settings.iter().flat_map(|s| ["--set", s]).collect();
        succeed(here, &[&["run", "p.ron", "--out", "r", "-q"][..], &set].concat());
    }
    file::read(&here.join(MODEL)).unwrap()
}

/// The columns of a binary PLY file whose properties are all `float`, by name.
fn ply(path: &Path) -> BTreeMap<String, Vec<f32>> {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let header = std::str::from_utf8(&bytes[..end]).unwrap();
    let mut lines = header.lines();
    assert_eq!(lines.next(), Some("ply"));
    assert_eq!(lines.next(), Some("format binary_little_endian 1.0"));
    let n: usize = lines.next().unwrap().strip_prefix("element vertex ").unwrap().parse().unwrap();
    let names: Vec<&str> = lines.map_while(|line| line.strip_prefix("property float ")).collect();
    let order = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
    assert_eq!(names.join(" "), order, "the order of 3D Gaussian splatting");
    let numbers: Vec<f32> = bytes[end..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!((bytes.len() - end, numbers.len()), (4 * n * names.len(), n * names.len()));
    let column = |k: usize| numbers.iter().skip(k).step_by(names.len()).copied().collect();
    names.iter().enumerate().map(|(k, name)| ((*name).to_owned(), column(k))).collect()
}

/// Columns `name_0`, `name_1`, .. as rows.
fn rows<const K: usize>(ply: &BTreeMap<String, Vec<f32>>, names: [&str; K]) -> Vec<[f32; K]> {
    (0..ply["x"].len()).map(|i| names.map(|name| ply[name][i])).collect()
}

fn close(a: f32, b: Real) -> bool {
    (a as Real - b).abs() <= 1e-5 * (1.0 + b.abs())
}

/// What a viewer shows of each Gaussian: red, green, blue.
fn colours(ply: &BTreeMap<String, Vec<f32>>) -> Vec<[f64; 3]> {
    let shown = |c: f32| 0.5 + 0.282_094_791_773_878_14 * f64::from(c);
    rows(ply, ["f_dc_0", "f_dc_1", "f_dc_2"]).iter().map(|c| c.map(shown)).collect()
}

fn luminance([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r.powf(2.2) + 0.7152 * g.powf(2.2) + 0.0722 * b.powf(2.2)
}

/// Geometry of a PLY file against scales and rotations.
fn same_geometry(ply: &BTreeMap<String, Vec<f32>>, model: &Model, scales: &[[Real; 3]], quats: &[[Real; 4]]) {
    for (i, (seen, scale)) in rows(ply, ["scale_0", "scale_1", "scale_2"]).iter().zip(scales).enumerate() {
        assert!((0..3).all(|k| close(seen[k].exp(), scale[k])), "{seen:?} {scale:?}");
        assert!(close(ply["opacity"][i], model.cloud.opacity_logits[i]));
        assert!(["nx", "ny", "nz"].iter().all(|name| ply[*name][i] == 0.0));
    }
    for (seen, quat) in rows(ply, ["rot_0", "rot_1", "rot_2", "rot_3"]).iter().zip(quats) {
        assert!((0..4).all(|k| close(seen[k], quat[k])), "{seen:?} {quat:?}");
    }
}

#[test]
fn exports_ply_of_base_or_of_one_transmitter() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let model = trained(here, &[]);
    succeed(here, &["export", MODEL, "--ply", "base.ply"]);
    succeed(here, &["export", MODEL, "--ply", "at.ply", "--tx=0.3,-0.25,1.5", "-q"]);
    let (base, at) = (ply(&here.join("base.ply")), ply(&here.join("at.ply")));
    // Our own reader of point clouds finds the centres.
    for name in ["base.ply", "at.ply"] {
        let points = read_points(&here.join(name)).unwrap();
        assert_eq!(points.len(), model.cloud.len());
        assert!(points.iter().zip(&model.cloud.means).all(|(p, m)| (0..3).all(|k| close(p[k] as f32, m[k]))));
    }
    let unit = |q: [Real; 4]| q.map(|v| v / q.iter().map(|v| v * v).sum::<Real>().sqrt());
    let scales: Vec<[Real; 3]> = model.cloud.log_scales.iter().map(|s| s.map(Real::exp)).collect();
    let quats: Vec<[Real; 4]> = model.cloud.quats.iter().copied().map(unit).collect();
    same_geometry(&base, &model, &scales, &quats);

    let stages = &model.stages;
    let deformation = stages.deformation().unwrap();
    let txs = [TX.map(|x| x as Real)];
    let pose = stages.pose();
    let inputs = DeformationInputs::new(&model.weights, &model.cloud.means, &txs, &pose);
    let deltas = deformation.forward(&inputs, &None);
    assert!(deltas.scales.iter().flatten().any(|d| d.abs() > 1e-4), "the network must move something");
    let sum = |a: &[Real; 3], b: &[Real; 3]| [0, 1, 2].map(|k| (a[k] + b[k]).max(1e-4));
    let scales: Vec<_> = scales.iter().zip(&deltas.scales).map(|(a, b)| sum(a, b)).collect();
    let turned = |a: &[Real; 4], b: &[Real; 4]| unit([0, 1, 2, 3].map(|k| a[k] + b[k]));
    let quats: Vec<_> = quats.iter().zip(&deltas.quats).map(|(a, b)| turned(a, b)).collect();
    same_geometry(&at, &model, &scales, &quats);

    // Brighter means a stronger signal; both ends of the scale are colours, not clipped ones.
    let strength = |s: [Real; 2]| s[0].hypot(s[1]).min(1.0);
    let own: Vec<Real> = model.cloud.signals.iter().map(|s| strength(*s)).collect();
    let added = |(s, d): (&[Real; 2], &[Real; 2])| strength([s[0] + d[0], s[1] + d[1]]);
    let there: Vec<Real> = model.cloud.signals.iter().zip(&deltas.signals).map(added).collect();
    for (file, strengths) in [(&base, own), (&at, there)] {
        let colours = colours(file);
        assert!(colours.iter().flatten().all(|c| (-1e-6..1.0 + 1e-6).contains(c)), "{colours:?}");
        for i in 0..strengths.len() {
            for j in 0..strengths.len() {
                let (a, b) = (luminance(colours[i]), luminance(colours[j]));
                // A step of eight bits may hide a small difference.
                assert!(strengths[i] < strengths[j] + 0.01 || a > b, "{strengths:?} {colours:?}");
            }
        }
    }
}

#[test]
fn export_without_transmitter_has_grey_signals() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here, &["deformation=Wrfgs(depth: 2, width: 8, skip: None)", "readout=Real", "calibration=AsReleased"]);
    succeed(here, &["export", MODEL, "--ply", "base.ply", "--npz", "base.npz"]);
    succeed(here, &["export", MODEL, "--ply", "at.ply", "--npz", "at.npz", "--tx", "0.3,-0.25,1.5"]);
    assert!(colours(&ply(&here.join("base.ply"))).iter().flatten().all(|c| *c == 0.5));
    let at = ply(&here.join("at.ply"));
    assert!(colours(&at).iter().flatten().any(|c| *c != 0.5));
    assert!(at.values().flatten().all(|v| v.is_finite()));
    assert_eq!(npz(&here.join("at.npz"))["tx.signals"].0, [at["x"].len(), 1], "one channel");
}

/// The arrays of an NPZ file: shapes, and numbers of any type in double precision.
fn npz(path: &Path) -> BTreeMap<String, (Vec<usize>, Vec<f64>)> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
    let names: Vec<String> = archive.file_names().map(|name| name.unwrap().into_owned()).collect();
    let read = |name: String| {
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut archive.by_name(&name).unwrap(), &mut bytes).unwrap();
        (name.strip_suffix(".npy").unwrap().to_owned(), npy(&bytes))
    };
    names.into_iter().map(read).collect()
}

#[test]
fn npz_export_contains_every_number_of_model() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let model = trained(here, &[]);
    succeed(here, &["export", MODEL, "--npz", "base.npz"]);
    succeed(here, &["export", MODEL, "--npz", "at.npz", "--tx=0.3,-0.25,1.5"]);
    let (base, at) = (npz(&here.join("base.npz")), npz(&here.join("at.npz")));
    let n = model.cloud.len();
    for (name, width, values) in model.cloud.columns() {
        let shape = if width == 1 { vec![n] } else { vec![n, width] };
        assert_eq!(base[name], (shape, values.iter().map(|v| *v as f64).collect()), "{name}");
    }
    let mut weights = Vec::new();
    for spec in model.stages.layout().weights {
        let (shape, values) = &base[&format!("network.{}", spec.name)];
        assert_eq!(*shape, spec.shape);
        weights.extend(values.iter().map(|v| *v as Real));
    }
    assert_eq!(weights, model.weights);
    assert_eq!(base["pose.position"].1, model.stages.pose().position);
    assert_eq!(base["pose.orientation"].1, model.stages.pose().orientation);
    assert_eq!(base["plane.size"], (vec![2], vec![48.0, 12.0]));
    assert_eq!(base["plane.wraps"], (vec![], vec![1.0]));
    let (azimuth, elevation) = model.stages.plane.angles.unwrap();
    assert_eq!(base["plane.azimuth_deg"].1, [azimuth.first, azimuth.step]);
    assert_eq!(base["plane.elevation_deg"].1, [elevation.first, elevation.step]);

    // The transmitter adds what is drawn, and changes nothing else.
    assert!(base.iter().all(|(name, array)| at[name] == *array));
    let Activated { primitives, signals, .. } = model.gaussians(Some(TX));
    let same = |name: &str, values: &[Real]| {
        assert_eq!(at[name].1, values.iter().map(|v| *v as f64).collect::<Vec<_>>(), "{name}");
    };
    same("tx.position", &TX.map(|x| x as Real));
    same("tx.scales", primitives.scales.as_flattened());
    same("tx.quats", primitives.quats.as_flattened());
    same("tx.opacities", &model.cloud.opacity_logits.iter().map(|o| sigmoid(*o)).collect::<Vec<_>>());
    same("tx.signals", &signals);
    assert_eq!(at.len(), base.len() + 5);

    let again = std::fs::read(here.join("base.npz")).unwrap();
    std::fs::remove_file(here.join("base.npz")).unwrap();
    succeed(here, &["export", MODEL, "--npz", "base.npz"]);
    assert_eq!(std::fs::read(here.join("base.npz")).unwrap(), again, "the same model gives the same bytes");
}

#[test]
fn export_errors_leave_files_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    trained(here, &[]);
    let wrong = |arguments: &[&str], words: &[&str]| refuse(here, &[&["export"], arguments].concat(), 2, words);
    wrong(&[MODEL], &["--ply"]);
    wrong(&[MODEL, "--tx", "0,0,1"], &["--ply"]);
    wrong(&["none.safetensors", "--ply", "o.ply"], &["cannot read none.safetensors"]);
    wrong(&["p.ron", "--npz", "o.npz"], &["p.ron", "model.safetensors of a finished run"]);
    wrong(&["r/checkpoint.safetensors", "--ply", "o.ply"], &["checkpoint.safetensors"]);
    for tx in ["1,2", "1,2,x", "1,NaN,2", ""] {
        wrong(&[MODEL, "--ply", "o.ply", "--tx", tx], &[&format!("--tx {tx}")]);
    }
    wrong(&[MODEL, "--ply", "o", "--npz", "o"], &["the same file"]);
    let mut model = file::read(&here.join(MODEL)).unwrap();
    model.cloud.log_scales[3][1] = 1e3;
    file::write(&here.join("r/burst.safetensors"), &model).unwrap();
    wrong(&["r/burst.safetensors", "--npz", "o.npz", "--ply", "o.ply"], &["`scale_1` of Gaussian 3 is not finite"]);
    // The first of two files may not be written when the second cannot be.
    write(&here.join("thesis.npz"), "years of work");
    wrong(&[MODEL, "--ply", "o.ply", "--npz", "thesis.npz"], &["thesis.npz exists"]);
    wrong(&[MODEL, "--ply", MODEL], &["exists; choose another name"]);
    wrong(&[MODEL, "--ply", "r"], &["r exists"]);
    assert_eq!(std::fs::read(here.join("thesis.npz")).unwrap(), b"years of work");
    wrong(&[MODEL, "--ply", "no/folder.ply"], &["no/folder.ply: the folder `no` does not exist; create it"]);
    let mut left: Vec<String> =
        std::fs::read_dir(here).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
    left.sort();
    assert_eq!(left, ["p.ron", "r", "thesis.npz"]);
}

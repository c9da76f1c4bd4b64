//! Predictions of `model_format.py`, which specifies them with NumPy alone, against those of the program.

use crate::common::{SMALL, python, refuse, succeed, write};
use pwrfgs::methods::Calibration::{AsReleased, Physical};
use pwrfgs::methods::{Calibration, Readout, Splatting};
use pwrfgs::model::tensors::Tensors;
use pwrfgs::model::{Ensemble, Model, Stages, file};
use pwrfgs_core::{
    End, GaussianCloud, ImagePlane, MeasurementSetup, Method, Origin, Plugin, Pose, Projector, Real, Receiver, Task,
    Vec3, rng,
};
use std::path::Path;
use std::process::Command;

/// Said where there is no NumPy.
pub(crate) const NO_PYTHON: &str = "model_format.py was not run";

/// Deformation, projector, rasterizer, calibration and readout: each of them somewhere.
const CASES: [(&str, &str, &str, Calibration, Readout); 11] = [
    ("Mlp(depth: 4, width: 24, skip: Some(1))", "Mercator()", "AlphaBlending()", Physical, Readout::Magnitude),
    (
        "Mlp(depth: 2, width: 16, skip: None, tx_frequencies: 3, outputs: Signals)",
        "Mercator(near_m: 1, margin_deg: 5, blur: 0.5)",
        "AlphaBlending()",
        Physical,
        Readout::Power,
    ),
    (
        "Factored(depth: 2, width: 16, tx_encoding: Waves(count: 9, reach: 24.0, seed: 7))",
        "Mercator()",
        "ArrayResponse(positions_wavelengths: [(0, 0, 0), (0.4, 0.1, 0.2), (-0.3, 0.5, -0.1), (0.3, -0.5, 0.1)])",
        Physical,
        Readout::MinMax,
    ),
    (
        "Factored(depth: 1, width: 8, tx_encoding: Octaves(4), position_encoding: Octaves(3))",
        "Mercator()",
        "AlphaBlending()",
        Physical,
        Readout::MinMax,
    ),
    (
        "Factored(width: 12, position_encoding: Waves(count: 5, reach: 3), near: (count: 7, length_m: 1.5))",
        "Mercator()",
        "ArrayResponse(rows: 3, columns: 2, spacing_wavelengths: 0.7, wavefront: Spherical(wavelength_m: 0.9))",
        Physical,
        Readout::Magnitude,
    ),
    (
        "Wrfgs(depth: 3, width: 16, skip: 0)",
        "WrfgsCompat()",
        "AlphaBlending(support: TileSquares)",
        AsReleased,
        Readout::Real,
    ),
    ("Wrfgs(depth: 2, width: 12, skip: None, gain: 30)", "Mercator()", "AlphaBlending()", Physical, Readout::Magnitude),
    ("Fixed()", "Mercator()", "ArrayResponse(widened: false)", Physical, Readout::Power),
    ("Fixed()", "Pinhole(near_m: 0.5, margin: 0.05)", "AlphaBlending()", Physical, Readout::Magnitude),
    ("Mlp(depth: 2, width: 16, skip: None)", "WrfgsCompat()", "AlphaBlending()", AsReleased, Readout::Magnitude),
    (
        "Factored(width: 12, tx_encoding: Wavelengths(count: 3, longest_m: 40, shortest_m: 2), \
         position_encoding: Wavelengths(count: 4, longest_m: 9, shortest_m: 1))",
        "Mercator()",
        "AlphaBlending()",
        Physical,
        Readout::Magnitude,
    ),
];

/// Receiver that stands and looks anywhere.
const POSE: Pose = Pose { position: [0.3, -0.2, 0.5], orientation: [0.2, -0.3, 0.1, 0.927_361_849_549_570_4] };

/// Gaussians of all sizes on all sides of the receiver: some too near, some below its horizon, one on its axis, many
/// opaque.
fn cloud() -> GaussianCloud {
    let mut random = rng::stream(5, "model format", 0);
    let mut cloud = GaussianCloud::zeros(60);
    for (name, width, values) in cloud.columns_mut() {
        let (centre, size) = match name {
            "means" => (0.0, 2.0),
            "log_scales" => (-1.2, 1.0),
            "opacity_logits" => (2.0, 4.0),
            _ => (0.2, 1.0),
        };
        assert_eq!(values.len(), 60 * width);
        values.iter_mut().for_each(|v| *v = centre + size * rng::normal(&mut random));
    }
    let (origin, rotation, near) = (POSE.position_vec(), POSE.world_from_receiver(), Vec3::new(0.05, 0.02, 0.1));
    // The second is too near for `WrfgsCompat`, whose centre is at -R·position.
    let special = [origin + near, near - rotation * origin, origin + rotation * Vec3::new(0.0, 0.0, 4.0)];
    cloud.means[..3].copy_from_slice(&special.map(|x| x.to_array()));
    cloud
}

/// A model with the weights that training would start from; those of `near` are random, since they start from 0.
fn model(
    (deformation, projector, rasterizer, calibration, readout): (&str, &str, &str, Calibration, Readout),
) -> Model {
    let projector: Plugin<dyn Projector> = Plugin::parse(projector).unwrap();
    let setup = MeasurementSetup::spectra(Origin::ZERO, POSE, projector.plane(60, 24));
    let splatting = Splatting {
        deformation: Plugin::parse(deformation).unwrap(),
        rasterizer: Plugin::parse(rasterizer).unwrap(),
        projector,
        calibration,
        readout,
    };
    let stages = Stages::new(splatting, setup);
    let (layout, mut random) = (stages.layout(), rng::stream(2, "near", 0));
    let mut weights: Vec<Real> = layout.init(&mut rng::stream(1, "weights", 0));
    let mut rest = weights.as_mut_slice();
    for spec in &layout.weights {
        let (own, others) = rest.split_at_mut(spec.len());
        if spec.name.contains("near.") {
            own.fill_with(|| rng::normal(&mut random));
        }
        rest = others;
    }
    Model { stages, cloud: cloud(), weights, training_positions: None }
}

/// Wide Gaussians that are equally far from the receiver but for the rounding of their means.
fn tied() -> Model {
    let mut model = model(CASES[0]);
    let centre = POSE.position_vec();
    for (mean, scales) in model.cloud.means.iter_mut().zip(&mut model.cloud.log_scales) {
        *mean = (centre + (Vec3::from_array(*mean) - centre).normalize() * 5.0).to_array();
        *scales = scales.map(|s| s + 1.5);
    }
    model
}

/// A model of each case.
pub(crate) fn models() -> impl Iterator<Item = Model> {
    CASES.into_iter().map(model).chain([tied()])
}

/// Channels of an array that is turned, on two subcarriers.
pub(crate) fn virtual_transmitters(order: usize) -> Model {
    let antennas = vec![[0.0; 3], [0.1, 0.0, 0.02], [0.0, -0.1, 0.0]];
    let receivers = vec![Receiver { antennas, ..Receiver::new("turned", POSE) }];
    let plane = ImagePlane::plain(2, 6);
    let frequencies_hz = vec![0.9e9, 0.95e9];
    let setup = MeasurementSetup {
        origin: Origin([10.0, 0.0, -3.0]),
        receivers,
        task: Task::Channel,
        plane,
        frequencies_hz,
        moving: End::Transmitter,
        transmitter: None,
        geodetic: None,
    };
    let method: Plugin<dyn Method> = Plugin::parse(&format!("VirtualTransmitters(order: {order})")).unwrap();
    let mut cloud = cloud();
    cloud.add_missing_columns(&method.traits().columns).unwrap();
    let mut random = rng::stream(6, "harmonics", 0);
    cloud.extra.iter_mut().for_each(|column| column.values.fill_with(|| rng::normal(&mut random)));
    Model { stages: Stages { method, setup }, cloud, weights: Vec::new(), training_positions: None }
}

/// Spectra at three carriers.
pub(crate) fn of_carriers(network: &str) -> Model {
    let mut model = model(CASES[0]);
    let at = |hz| Receiver::new("", POSE).at_carrier(hz);
    model.stages.setup.receivers = vec![at(2e9), at(2.4e9), at(3e9)];
    let method = format!("Splatting(deformation: {network}, projector: Mercator(), readout: Magnitude)");
    model.stages.method = Plugin::parse(&method).unwrap();
    model.weights = model.stages.layout().init(&mut rng::stream(7, "carriers", 0));
    model
}

/// Predictions of a model file in the folder `out`.
pub(crate) fn predict(here: &Path, model: &str, out: &str) {
    let [x, y, z] = file::read_ensemble(&here.join(model)).unwrap().members()[0].stages.origin.0;
    let row = |dx, dy, dz| format!("{},{},{}\n", x + dx, y + dy, z + dz);
    write(&here.join("tx.csv"), format!("x,y,z\n{}{}", row(0.4, -0.3, 1.1), row(-1.25, 2.0, 0.2)));
    succeed(here, &["predict", model, "--tx-csv", "tx.csv", "--out", out]);
}

/// How many predictions the reader makes again from pairs of a model and its predictions; all must be the same.
pub(crate) fn predicted_again(python: &str, here: &Path, pairs: &[String]) -> usize {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/model_format.py");
    let output = Command::new(python).arg(script).args(pairs).current_dir(here).output().unwrap();
    let message = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{message}");
    println!("{message}");
    message.matches("same ").count()
}

#[test]
fn numpy_predicts_from_documented_format() {
    let Some(python) = python(NO_PYTHON) else { return };
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut pairs = Vec::new();
    for (k, mut model) in models().enumerate() {
        pairs.extend([format!("{k}.safetensors"), format!("{k}")]);
        model.stages.origin = Origin(if k % 2 == 0 { [0.0; 3] } else { [5e5, 54e5, -1e2] });
        file::write(&here.join(&pairs[2 * k]), &model).unwrap();
    }
    for order in [0, 3] {
        let name = format!("waves-{order}");
        file::write(&here.join(format!("{name}.safetensors")), &virtual_transmitters(order)).unwrap();
        pairs.extend([format!("{name}.safetensors"), name]);
    }
    for (k, network) in ["Factored(depth: 2, width: 8, carrier: 2)", "Mlp(depth: 2, width: 8, skip: None, carrier: 2)"]
        .iter()
        .enumerate()
    {
        let name = format!("carriers-{k}");
        file::write(&here.join(format!("{name}.safetensors")), &of_carriers(network)).unwrap();
        pairs.extend([format!("{name}.safetensors"), name]);
    }
    // Ensembles with residuals, of spectra and of powers at four receivers.
    for name in ["residuals", "powers"] {
        let committed = crate::versions::folder().join(format!("{name}.safetensors"));
        std::fs::copy(committed, here.join(format!("{name}.safetensors"))).unwrap();
        pairs.extend([format!("{name}.safetensors"), name.into()]);
    }
    // And one that was trained, as it is and with its network in 16 bits.
    let waves =
        "Factored(depth: 2, width: 16, tx_encoding: Waves(count: 6, reach: 20), near: (count: 9, length_m: 0.5))";
    write(&here.join("p.ron"), SMALL.replace("Mlp(depth: 2, width: 16, skip: None)", waves));
    succeed(here, &["run", "p.ron", "--out", "run", "-q", "--set", "rasterizer=ArrayResponse()"]);
    succeed(here, &["export", "run/model.safetensors", "--half", "half.safetensors"]);
    pairs.extend(["run/model.safetensors", "trained", "half.safetensors", "half"].map(String::from));
    // And all in one file.
    let trained = file::read(&here.join("run/model.safetensors")).unwrap();
    let half = file::read(&here.join("half.safetensors")).unwrap();
    let together = Ensemble::named(vec![("trained".into(), trained), ("half".into(), half)]).unwrap();
    file::write_ensemble(&here.join("both.safetensors"), &together).unwrap();
    pairs.extend(["both.safetensors", "both"].map(String::from));
    pairs.chunks_exact(2).for_each(|pair| predict(here, &pair[0], &pair[1]));
    assert_eq!(
        predicted_again(python, here, &pairs),
        pairs.len() + 14,
        "two positions a model, at each carrier and receiver"
    );
}

#[test]
fn restores_missing_encoding_waves_and_rejects_others() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let model = model(CASES[2]);
    let mut tensors = Tensors::from_bytes(&file::to_bytes(&model)).unwrap();
    let waves = tensors.take("constants.tx_encoding", &[9, 3]).unwrap();
    tensors.take("constants.position_encoding", &[32, 3]).unwrap();
    write(&here.join("old.safetensors"), tensors.to_bytes());
    let old = file::read(&here.join("old.safetensors")).unwrap();
    assert_eq!(file::to_bytes(&old), file::to_bytes(&model), "drawn again from the seed");
    tensors.put("constants.tx_encoding", vec![9, 3], waves.iter().map(|k| k + 0.01).collect());
    write(&here.join("other.safetensors"), tensors.to_bytes());
    let words = ["other.safetensors", "`constants.tx_encoding` differs from"];
    refuse(here, &["predict", "other.safetensors", "--tx=0,0,1", "--out", "o"], 2, &words);
}

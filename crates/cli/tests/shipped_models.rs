//! Predictions with `model_format.py` for the model of every shipped pipeline, trained for a few steps.

use crate::common::{python, succeed, write};
use crate::model_format::{NO_PYTHON, predict, predicted_again};
use crate::tensors::check_listed;
use pwrfgs::data::{npy_header, npy_header_as};
use pwrfgs::experiment::{NoopObserver, SplitData, load_split_data, read_pipeline};
use pwrfgs::model::{Ensemble, Model, compress, file};
use pwrfgs::pipeline::Pipeline;
use pwrfgs_core::plugin::to_ron;
use pwrfgs_core::{Number, Query, Real, Task, gains_of};
use std::path::{Path, PathBuf};

/// Snapshots that are asked for where a model reads features.
const ASKED: usize = 2;

/// A folder of the project.
fn project(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(name)
}

/// Small data of the kind that a pipeline reads, as an argument of `--set`.
fn small_data(pipeline: &Pipeline, uplinks: &Path) -> String {
    let simulated = |scene: &str, observe: &str| {
        let scene = project("scenes").join(scene).display().to_string();
        format!("data=Simulated(scene: {scene:?}, samples: 12, points: 50, cache: false{observe})")
    };
    match pipeline.data.task() {
        Some(Task::Power) => simulated("office-links.ron", ", observe: Power()"),
        Some(Task::Channel) if pipeline.method().traits().inputs != 3 => {
            format!("data.root={:?}", uplinks.display().to_string())
        }
        Some(Task::Channel) => simulated("office-channel.ron", ", observe: Channel()"),
        _ if to_ron(&pipeline.data).contains("office-links") => simulated("office-links.ron", ""),
        _ => "data=Teacher(gaussians: 4, samples: 20, width: 72, height: 18)".into(),
    }
}

/// What makes a pipeline small and leaves the kind of its model as it is.
fn changes(pipeline: &Pipeline, uplinks: &Path) -> Vec<String> {
    let mut changes = vec![small_data(pipeline, uplinks), "split=Random(validation: 0)".into()];
    changes.push("training=(steps: 4, batch: 4, densify_until: 0, prune_until: 0, target_count: 0)".into());
    if pipeline.method().traits().has_gaussians() {
        changes.extend(["pruners=[]", "training.densify=(every: 0)"].map(String::from));
    } else {
        changes.extend(["width=8", "samples=6"].map(|field| format!("method.Nerf2.{field}")));
        changes.push("training.rays=All".into());
    }
    if !to_ron(&pipeline.initializer).starts_with("Grid") && pipeline.method().traits().has_gaussians() {
        changes.push("initializer=Random(count: 50, std: 3.0)".into());
    }
    changes
}

fn trained(pipeline: &Pipeline) -> Model {
    let SplitData { data, partition } = load_split_data(pipeline, &mut NoopObserver).unwrap_or_else(|e| panic!("{e}"));
    let mut trainer = pipeline.trainer(&data, &partition).unwrap_or_else(|e| panic!("{e}"));
    while !trainer.finished() {
        trainer.step().unwrap();
    }
    trainer.model()
}

/// The model that the pipeline in `path` makes with one more change.
fn model_of(path: &Path, uplinks: &Path, more: Option<&str>) -> Ensemble {
    let read = |changes: &[String]| read_pipeline(path, changes).unwrap_or_else(|e| panic!("{e}"));
    let mut small = changes(&read(&[]), uplinks);
    small.extend(more.map(String::from));
    Ensemble::of(trained(&read(&small)))
}

/// What `pwrfgs predict` writes, of a model that it refuses because it reads features.
fn predict_from_features(ensemble: &Ensemble, out: &Path) {
    let prepared = ensemble.prepare();
    let width = ensemble.members()[0].stages.method.traits().inputs;
    let features: Vec<Real> = (0..ASKED * width).map(|k| (0.7 * k as Real).sin()).collect();
    let floats = |values: &[Real]| values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect::<Vec<u8>>();
    write(&out.join("features.npy"), [npy_header(Number::F32, &[ASKED, width]), floats(&features)].concat());
    let of_each = features.chunks_exact(width).enumerate();
    let rows = of_each.map(|(k, features)| {
        let receiver = k % prepared.receivers().len();
        let found = prepared.predict_timed(Query { features: Some(features), ..Query::at([0.0; 3], receiver) }).0;
        let header = npy_header_as("<c8", &[found.height / 2, found.width]);
        let gains = floats(gains_of(&found.pixels, found.width).as_flattened());
        write(&out.join(format!("{:05}.npy", k + 1)), [header, gains].concat());
        format!("{},0,0,0,{}\n", k + 1, prepared.receivers()[receiver].name)
    });
    let rows: String = rows.collect();
    write(&out.join("predictions.csv"), format!("row,x,y,z,receiver\n{rows}"));
}

#[test]
fn numpy_predicts_from_model_of_every_shipped_pipeline() {
    let Some(python) = python(NO_PYTHON) else { return };
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let (scene, uplinks) = (project("scenes/office-csi.ron").display().to_string(), here.join("uplinks"));
    let data = ["--layout", "csi", "--samples", "12", "--points", "50", "--snr-db", "30", "--out", "uplinks"];
    succeed(here, &[&["simulate", &scene], &data[..]].concat());
    let files = project("pipelines").read_dir().unwrap().map(|entry| entry.unwrap().path());
    let mut cases: Vec<_> =
        files.map(|path| (path.file_stem().unwrap().to_str().unwrap().to_owned(), path, None)).collect();
    cases.sort();
    let pseudo = "method.deformation.tx_encoding=PseudoPosition(width: 416, gain: 0.5, octaves: 3)";
    cases.push(("pseudo".into(), project("pipelines/uplink.ron"), Some(pseudo)));
    let (mut pairs, mut expected) = (Vec::new(), 0);
    for (name, path, more) in cases {
        let (ensemble, saved) = (model_of(&path, &uplinks, more), format!("{name}.safetensors"));
        // Whole files, and compressed ones of every second pipeline.
        let ensemble = match compress::to_bytes(&ensemble, compress::Bits::Eight) {
            Ok(small) if pairs.len() % 4 == 0 => {
                write(&here.join(&saved), &small);
                file::from_bytes(&small).unwrap()
            }
            _ => {
                file::write_ensemble(&here.join(&saved), &ensemble).unwrap();
                ensemble
            }
        };
        check_listed(&name, &std::fs::read(here.join(&saved)).unwrap());
        if ensemble.members()[0].stages.method.traits().inputs == 3 {
            predict(here, &saved, &name);
            expected += 2 * ensemble.prepare().receivers().len();
        } else {
            predict_from_features(&ensemble, &here.join(&name));
            expected += ASKED;
        }
        pairs.extend([saved, name]);
    }
    assert_eq!(predicted_again(python, here, &pairs), expected);
}

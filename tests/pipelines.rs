//! Every shipped pipeline parses, is written as the same text, and trains some steps on a small teacher.
use pwrfgs::core::ShippedFile;
use pwrfgs::experiment::sweep::{JOINED, SweepPlan};
use pwrfgs::experiment::{RunOutcome, Session, SplitData};
use pwrfgs::prelude::*;
use pwrfgs::raytrace::output::{DatasetWriter, OutputLayout};
use pwrfgs::raytrace::{ObservationKind, SimulationRecipe};
use pwrfgs::train::Rays;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

/// The RON files of a folder of the project.
fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "ron"));
    files.sort();
    files
}

fn read(path: &Path) -> Pipeline {
    Pipeline::parse(&std::fs::read_to_string(path).unwrap(), path).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn program_ships_every_pipeline_experiment_and_scene() {
    for folder in [ShippedFile::PIPELINES, ShippedFile::EXPERIMENTS, ShippedFile::SCENES] {
        let shipped = ShippedFile::all(folder);
        for path in files(folder) {
            let name = path.file_stem().unwrap().to_str().unwrap();
            let Some(file) = shipped.iter().find(|file| file.name == name) else {
                assert_eq!(name, "conference", "only the scene with a mesh is not shipped");
                continue;
            };
            assert_eq!(file.source, std::fs::read_to_string(&path).unwrap());
            assert!(!file.text().contains("../"), "{name}");
        }
    }
    let named = |pipeline: &str| ShippedFile::all(ShippedFile::PIPELINES).iter().any(|file| file.name == pipeline);
    assert!(["office-init", "pwrfgs", "quickstart", "s23-array", "s23-laptop", "wrfgs"].into_iter().all(named));
    for file in ShippedFile::all(ShippedFile::PIPELINES) {
        let pipeline = Pipeline::parse(&file.text(), Path::new(file.name)).unwrap_or_else(|e| panic!("{e}"));
        let text = pipeline.to_ron().unwrap();
        let scene = text.split_once("scene: \"").map(|(_, rest)| rest.split('"').next().unwrap());
        let is_shipped = |scene| ShippedFile::find(ShippedFile::SCENES, Path::new(""), Path::new(scene)).is_some();
        assert!(scene.is_none_or(is_shipped), "{}: {scene:?}", file.name);
    }
}

/// `report` and `predict` open runs of the Python package, whose pruners this program does not have.
#[test]
fn target_of_an_unavailable_pruner_is_not_checked() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/quickstart.ron");
    let with = |pruners: &str| {
        let set = [format!("pruners={pruners}"), "training.target_count=50".into()];
        pwrfgs::experiment::read_pipeline(&file, &set).map(drop).map_err(|e| e.to_string())
    };
    assert_eq!(with("[Python(module: \"mine\", class: \"Brightest\")]"), Ok(()));
    assert!(with("[]").unwrap_err().contains("no pruner supports a target"));
}

#[test]
fn every_pipeline_round_trips_through_ron() {
    for path in files("pipelines") {
        let text = read(&path).to_ron().unwrap();
        let again = Pipeline::parse(&text, &path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        assert_eq!(again.to_ron().unwrap(), text, "{}", path.display());
        assert_eq!(
            read(&path).name,
            path.file_stem().unwrap().to_string_lossy(),
            "the run folder is named as the file"
        );
    }
}

/// A folder of simulated data, as an argument of `--set`.
fn simulated(scene: &str, observe: ObservationKind, layout: OutputLayout, folder: &Path) -> String {
    let recipe = SimulationRecipe::read(Path::new(scene), 20, 0, 100).unwrap().observing(observe).unwrap();
    let out = folder.join("simulated");
    let stop = &AtomicBool::new(false);
    DatasetWriter { layout, has_paths: false, progress: &|_, _| {}, stop }.write(&recipe, &out).unwrap();
    format!("data.root={:?}", out.display().to_string())
}

/// A small data set of a kind, as an argument of `--set`: features of so many numbers where these are no positions.
fn small(kind: Option<Task>, inputs: usize, folder: &Path) -> String {
    match kind {
        Some(Task::Power) => {
            "data=Simulated(scene: \"../scenes/office-links.ron\", samples: 20, points: 100, observe: Power())".into()
        }
        Some(Task::Channel) if inputs != 3 => simulated(
            "scenes/office-csi.ron",
            ObservationKind::Channel { snr_db: Some(30.0) },
            OutputLayout::Csi,
            folder,
        ),
        Some(Task::Channel) => {
            "data=Simulated(scene: \"../scenes/office-channel.ron\", samples: 20, points: 100, observe: Channel())"
                .into()
        }
        _ => "data=Teacher(gaussians: 4, samples: 30, width: 72, height: 18)".into(),
    }
}

/// A network of rays that a test has time for.
fn shrink(pipeline: &mut Pipeline) {
    if pipeline.method.as_ref().is_some_and(|method| !method.traits().has_gaussians()) {
        for (field, value) in [("depth", "2"), ("width", "8"), ("samples", "4")] {
            pipeline.set(&format!("method.Nerf2.{field}={value}")).unwrap();
        }
        match pipeline.training.rays {
            Rays::All => (),
            Rays::Same(_) => pipeline.set("training.rays=Same(50)").unwrap(),
            Rays::Each(_) => pipeline.set("training.rays=Each(50)").unwrap(),
        }
    }
}

#[test]
fn every_pipeline_runs_some_steps() {
    for path in files("pipelines") {
        let mut pipeline = read(&path);
        let count = if pipeline.deformation.traits().varies_geometry { 30 } else { 60 };
        let folder = tempfile::tempdir().unwrap();
        let data = if pipeline.name == "office-carriers" {
            "data=Simulated(scene: \"../scenes/office-carriers.ron\", samples: 20, points: 100)".to_owned() // its split names a carrier
        } else {
            small(pipeline.data.task(), pipeline.method().traits().inputs, folder.path())
        };
        for change in [
            format!("training.target_count={}", pipeline.training.target_count.min(20)), // the start has 30 or more
            data,
            format!("initializer=Random(count: {count}, std: 5.0)"),
            "baselines=[MeanSpectrum()]".to_owned(), // ray tracing needs a scene
            "training=(densify_until: 6, prune_until: 9)".to_owned(),
            "training.prune_every=2".to_owned(),
            "training.densify=(from: 1, every: 2, reset_every: 0)".to_owned(),
            "training.steps=12".to_owned(),
            "training.batch=8".to_owned(),
        ] {
            pipeline.set(&change).unwrap_or_else(|e| panic!("{}: {change}: {e}", path.display()));
        }
        shrink(&mut pipeline);
        let out = folder.path().join("run");
        let stop = AtomicBool::new(false);
        let outcome = pwrfgs::run(&pipeline, Path::new("pipelines"), &out, &mut NoopObserver, &stop);
        outcome.unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let curve = std::fs::read_to_string(out.join("curve.csv")).unwrap();
        assert_eq!(curve.lines().count(), 13, "{}", path.display());
        assert!(std::fs::read_to_string(out.join("report.html")).unwrap().contains("simulated"));
    }
}

#[test]
fn joined_sweeps_score_mean_of_their_models() {
    let powers = format!(
        "data=Simulated(scene: {:?}, samples: 30, points: 100, observe: Power())",
        Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/office-links.ron")
    );
    let mut joined = 0;
    for path in files("experiments") {
        let plan = SweepPlan::read(&path, &[], None).unwrap_or_else(|e| panic!("{e}"));
        if plan.joined.is_none() {
            continue;
        }
        let (data, names) = if plan.runs[0].pipeline.data.task() == Some(Task::Power) {
            (&*powers, ["seed-0", "seed-1", "seed-2", "seed-3"])
        } else {
            let spectra = "data=Teacher(gaussians: 4, samples: 30, width: 72, height: 18)";
            (spectra, ["blended-0", "blended-1", "waves-0", "waves-1"])
        };
        let set = [data, "split=Random()", "baselines=[MeanSpectrum()]"];
        joined += 1;
        let folder = tempfile::tempdir().unwrap();
        let mut plan =
            SweepPlan::read(&path, &set.map(str::to_owned), Some(folder.path())).unwrap_or_else(|e| panic!("{e}"));
        for run in &mut plan.runs {
            let short = "training=(steps: 6, densify_until: 0, prune_until: 4, prune_every: 2, batch: 4)";
            run.pipeline.set(short).unwrap();
        }
        let runs: Vec<usize> = (0..plan.runs.len()).collect();
        let end = plan
            .execute(&runs, 2, &NoopObserver, &mut Session::new(&mut NoopObserver))
            .unwrap_or_else(|e| panic!("{e}"));
        assert!(matches!(end.joined, Some(RunOutcome::Finished { already: false, .. })), "{end:?}");
        let model = pwrfgs::model::file::read_ensemble(&folder.path().join(JOINED).join("model.safetensors")).unwrap();
        assert_eq!(model.names(), names);
        let scores = std::fs::read_to_string(folder.path().join(JOINED).join("scores.csv")).unwrap();
        assert!(scores.contains("mean ") && scores.contains(&format!("member {}", names[3])));
    }
    assert!(joined > 0);
}

#[test]
fn every_experiment_resolves_and_its_variants_train() {
    let experiments = files("experiments");
    assert!(experiments.len() >= 5);
    for path in experiments {
        let whole = SweepPlan::read(&path, &[], None).unwrap_or_else(|e| panic!("{e}"));
        let (first, folder) = (&whole.runs[0].pipeline, tempfile::tempdir().unwrap());
        let data = if std::fs::read_to_string(&path).unwrap().contains("\"data.points\"") {
            simulated("scenes/lab-s23.ron", ObservationKind::Spectrum, OutputLayout::Images, folder.path())
        } else {
            small(first.data.task(), first.method().traits().inputs, folder.path()).replace("../scenes", "scenes")
        };
        let small = [&data, "baselines=[MeanSpectrum()]", "training.batch=8"];
        assert_eq!(whole.name, path.file_stem().unwrap().to_string_lossy(), "a sweep folder is named as the file");
        let plan = SweepPlan::read(&path, &small.map(str::to_owned), None).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(plan.runs.len(), whole.runs.len());
        let combinations = plan.runs.last().unwrap().combination + 1;
        assert!(plan.joined.is_some() || plan.runs.len() >= 3 * combinations, "three seeds or more");
        // Some steps of one run of those that differ in numbers alone.
        let mut kinds = std::collections::BTreeSet::new();
        for run in plan.runs.iter().filter(|r| r.pipeline.seed == 0) {
            let is_new = kinds.insert(run.folder.replace(|c: char| c.is_ascii_digit() || c == '.', ""));
            // The point cloud of the walls is simulated first.
            if !is_new || run.pipeline.training.target_count > 600 || run.folder.contains("on-walls") {
                continue;
            }
            let mut pipeline = run.pipeline.clone();
            pipeline.set("training=(steps: 12, batch: 8, densify_until: 6, prune_until: 9, prune_every: 2)").unwrap();
            pipeline.set("split=Random()").unwrap(); // thirty samples are too few for some
            let start = pwrfgs::core::plugin::to_ron(&pipeline.initializer);
            if start.starts_with("Trained") {
                pipeline.set("initializer=Random(count: 600)").unwrap(); // no model of it lies here
            } else if start.starts_with("MatchingPursuit") {
                pipeline.set("initializer=Random(count: 60)").unwrap(); // a search takes minutes
            } else if pipeline.initializer.count().is_some_and(|count| count > 600) {
                pipeline.set("initializer.count=600").unwrap();
            }
            shrink(&mut pipeline);
            let SplitData { data, partition } =
                pwrfgs::experiment::load_split_data(&pipeline, &mut NoopObserver).unwrap();
            let mut trainer = match pipeline.trainer(&data, &partition) {
                Ok(trainer) => trainer,
                Err(_) if run.folder.contains("point-cloud") => continue, // only this needs a scene
                Err(error) => panic!("{}: {error}", run.folder),
            };
            for _ in 0..12 {
                match trainer.step() {
                    Ok(report) => assert!(report.loss.is_finite(), "{}", run.folder),
                    Err(Error::Collapsed { .. }) => break, // thresholds of a long training, after a few steps
                    Err(error) => panic!("{}: {error}", run.folder),
                }
            }
        }
    }
}

/// Constants of `pwrfgs.ron` and the source of each.
const PAPER: [(&str, f64, &str); 27] = [
    ("steps", 200_000.0, "paper"),
    ("batch", 1.0, "paper, algorithm 1"),
    ("densify until", 20_000.0, "paper, M_d"),
    ("prune until", 40_000.0, "paper, M_p"),
    ("prune every", 1_000.0, "paper, I_p"),
    ("epsilon", 0.005, "paper"),
    ("lambda", 0.02, "paper, headline (N = 157)"),
    ("mask threshold", 0.01, "paper"),
    ("mask logit", 1.0, "Compact-3DGS"),
    ("mask rate", 0.01, "Compact-3DGS"),
    ("SSIM weight", 0.2, "paper, w"),
    ("count", 200_000.0, "WRF-GS+, random start"),
    ("spread", 20.0, "WRF-GS+, random start"),
    ("neighbours", 3.0, "WRF-GS+, initial scale"),
    ("opacity", 0.1, "WRF-GS+, initial opacity"),
    ("means first", 8e-4, "WRF-GS+, 1.6e-4 times spatial_lr_scale 5"),
    ("means last", 8e-6, "WRF-GS+, 1.6e-6 times spatial_lr_scale 5"),
    ("log-scales", 0.005, "WRF-GS+"),
    ("quaternions", 0.001, "WRF-GS+"),
    ("opacities", 0.025, "WRF-GS+"),
    ("signals", 7e-4, "WRF-GS+, 0.0025 times 0.2821 of a colour"),
    ("network first", 8e-4, "WRF-GS+"),
    ("network last", 1.6e-6, "WRF-GS+"),
    ("network steps", 600_000.0, "WRF-GS+"),
    ("extent", 2.0, "WRF-GS+, cameras_extent in scene/__init__.py"),
    ("size limit", 0.2, "WRF-GS+, 0.1 of the extent after step 3,000"),
    ("weights", 574_819.0, "WRF-GS+, 576,618 without two idle heads"),
];

#[test]
fn pwrfgs_has_the_constants_of_paper_and_released_code() {
    use pwrfgs::train::Schedule;
    let pipeline = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/pwrfgs.ron"));
    // Each of them as the pipeline states it, or as it is by default.
    let plugins = format!("{:?} {:?}", pipeline.pruners, pipeline.initializer);
    let plugin = |field: &str| -> f64 {
        let found = plugins.split_once(&format!(" {field}: ")).unwrap_or_else(|| panic!("no {field} in {plugins}")).1;
        found.split([',', ' ', '}']).next().unwrap().parse().unwrap()
    };
    let t = &pipeline.training;
    let (o, d) = (&t.optimizer, &t.densify);
    let constant = |schedule: Schedule| match schedule {
        Schedule::Constant(rate) => rate,
        other => panic!("{other:?}"),
    };
    let falling = |schedule: Schedule| match schedule {
        Schedule::LogLinear { first, last, steps } => (f64::from(first as f32), f64::from(last as f32), steps),
        other => panic!("{other:?}"),
    };
    let (means, network) = (falling(o.means), falling(o.network));
    let found = [
        t.steps as f64,
        t.batch as f64,
        t.densify_until as f64,
        t.prune_until as f64,
        t.prune_every as f64,
        plugin("epsilon"),
        plugin("lambda"),
        plugin("threshold"),
        plugin("initial_logit"),
        plugin("learning_rate"),
        f64::from(t.loss.ssim_weight as f32),
        plugin("count"),
        plugin("std"),
        plugin("nearest"),
        plugin("opacity"),
        means.0,
        means.1,
        f64::from(constant(o.log_scales) as f32),
        f64::from(constant(o.quats) as f32),
        f64::from(constant(o.opacity_logits) as f32),
        f64::from(constant(o.signals) as f32),
        network.0,
        network.1,
        network.2 as f64,
        f64::from(d.extent_m as f32),
        f64::from((d.large_above * d.extent_m) as f32),
        pipeline.deformation.layout().weight_count() as f64,
    ];
    for ((name, expected, source), found) in PAPER.iter().zip(found) {
        assert!((found / expected - 1.0).abs() < 1e-6, "{name}: {found}, expected {expected} ({source})");
    }
    assert_eq!(means.2, 30_000, "WRF-GS+, position_lr_max_steps");
    assert_eq!((d.from, d.every, d.large_after, d.reset_every), (500, 100, 3_000, 3_000), "WRF-GS+");
    assert_eq!((d.max_gaussians, t.stride, t.target_count), (0, 1, 0), "all pixels, no limit, no target");
    // The small pipelines change the numbers that their headers name, and nothing else.
    let small = |name: &str, changes: &[&str]| {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines").join(name);
        let mut whole = pipeline.clone();
        changes.iter().for_each(|change| whole.set(change).unwrap_or_else(|e| panic!("{e}")));
        assert_eq!(read(&file).to_ron().unwrap(), whole.to_ron().unwrap(), "{name}");
    };
    let start = [
        "name=\"pwrfgs-small\"",
        "initializer=Random(count: 2_000, std: 4.31)",
        "pruners.LearnableMask.lambda=0.0075",
        "training.densify.extent_m=60",
        "training.densify.max_gaussians=3_000",
    ];
    small("pwrfgs-small.ron", &start);
}

#[test]
fn wrfgs_densifies_at_steps_of_released_code() {
    let mut pipeline = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/wrfgs.ron"));
    pipeline.set("data=Teacher(gaussians: 4, samples: 30, width: 72, height: 18)").unwrap();
    pipeline.set("initializer.count=20").unwrap();
    let SplitData { data, partition } = pwrfgs::experiment::load_split_data(&pipeline, &mut NoopObserver).unwrap();
    let trainer = pipeline.trainer(&data, &partition).unwrap();
    let densify = &pipeline.training.densify;
    let is_due = |step: &u64| step.is_multiple_of(densify.every) && *step > densify.from;
    let steps = 1..=pipeline.training.steps;
    let due: Vec<u64> = steps.clone().filter(|step| is_due(step) && trainer.phase(*step) == Phase::Densify).collect();
    assert_eq!(due, (600..=14_900).step_by(100).collect::<Vec<u64>>());
    assert!(
        !steps.clone().any(|step| trainer.phase(step) == Phase::Prune),
        "the released code never prunes after that"
    );
}

#[test]
fn quickstart_uses_documented_office() {
    let mut pipeline = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines/quickstart.ron"));
    for change in [
        r#"data=Simulated(scene: "../scenes/office.ron", samples: 30, points: 500, cache: false)"#,
        "initializer=PointCloud(max_points: 40)",
        "training.densify_until=2",
        "training.prune_until=5",
        "training.prune_every=2",
        "training.batch=2",
        "training.steps=6",
    ] {
        pipeline.set(change).unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let base = Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines");
    let stop = AtomicBool::new(false);
    pwrfgs::run(&pipeline, &base, &folder.path().join("run"), &mut NoopObserver, &stop).unwrap();
    let report = std::fs::read_to_string(folder.path().join("run/report.html")).unwrap();
    assert!(report.contains("office (simulated)") && report.contains("upper bound"));
    let scores = std::fs::read_to_string(folder.path().join("run/scores.csv")).unwrap();
    assert!(scores.contains("RT exact"), "{scores}");
}

//! Simulated data sets: reproducible, cached completely or not at all, with clear errors.

use glam::DVec3;
use pwrfgs_core::{Baseline, DataSource, Dataset, End, FittingSet, Plugin, Pose, Simulation};
use pwrfgs_raytrace::output::{DatasetWriter, MANIFEST, OutputLayout, POINTS};
use pwrfgs_raytrace::scene::Orientation;
use pwrfgs_raytrace::spectrum::Spectrum;
use pwrfgs_raytrace::{
    ObservationKind, ReceiverObservation, SceneFile, SimulatedObservation, SimulationRecipe, Simulator, open_or_make,
};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Returns a small room with one of everything; `more` are further fields of the scene.
fn scene_text(more: &str) -> String {
    format!(
        r#"(
    name: "small",
    carrier_hz: 2.4e9,
    room: (
        outline: Box(low: (0, 0, 0), high: (4, 3, 2.5)),
        walls: (material: "plasterboard", thickness_m: 0.1),
        floor: (material: "concrete"),
        ceiling: (material: "wood", thickness_m: 0.02, roughness: 0.3),
    ),
    objects: [Box(name: "desk", low: (1, 1, 0), high: (2, 2, 0.7), finish: (material: "metal"))],
    receiver: (position: (0.2, 1.5, 1.5), orientation: Facing(direction: (1, 0, 0)), array: (rows: 4, columns: 4)),
    transmitter: (positions: Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))),
    {more}
)"#
    )
}

/// Writes a file, and returns its path.
fn file(folder: &Path, name: &str, text: &str) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, text).unwrap();
    path
}

/// Returns the recipe of 12 samples of the small room with noise.
fn recipe(folder: &Path) -> SimulationRecipe {
    let noise = "noise: (snr_db: 20, phase_error_deg: 3),";
    SimulationRecipe::read(&file(folder, "small.ron", &scene_text(noise)), 12, 7, 500).unwrap()
}

/// Writes the data set of a recipe.
fn write(recipe: &SimulationRecipe, layout: OutputLayout, paths: bool, out: &Path) -> pwrfgs_core::Result<()> {
    let stop = &AtomicBool::new(false);
    DatasetWriter { layout, has_paths: paths, progress: &|_, _| {}, stop }.write(recipe, out)
}

#[test]
fn refuses_to_simulate_into_non_empty_folder() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(folder.path());
    let message = write(&recipe, OutputLayout::Images, true, folder.path()).unwrap_err();
    assert!(message.is_input() && message.to_string().contains("is not empty (it holds `small.ron`)"), "{message}");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

/// Returns the spectrum of an observation.
fn spectrum(observation: ReceiverObservation) -> Spectrum {
    match observation.observed {
        SimulatedObservation::Spectrum(spectrum) => spectrum,
        other => panic!("{other:?}"),
    }
}

#[test]
fn stated_positions_keep_their_order_and_their_spectra() {
    let folder = tempfile::tempdir().unwrap();
    let [rows, back] = [["2.5,1.25,1.1", "1,2.123456,1.2", "3,2,0.9"], ["3,2,0.9", "1,2.123456,1.2", "2.5,1.25,1.1"]];
    let box_of = "Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))";
    let load = |name: &str, positions: &str| {
        let text = scene_text("").replace(box_of, positions);
        assert_ne!(text, scene_text(""));
        let path = file(folder.path(), name, &text);
        let source = format!("Simulated(scene: {path:?}, points: 20, cache: false)");
        Plugin::<dyn DataSource>::parse(&source).unwrap().load(Path::new(""), &|_, _| {}).unwrap()
    };
    let csv = |rows: [&str; 3]| "note,x,y,z\n".to_owned() + &rows.map(|row| format!("a,{row}\n")).concat();
    file(folder.path(), "walk.csv", &csv(rows));
    file(folder.path(), "back.csv", &csv(back));
    let walk = load("walk.ron", "Csv(\"walk.csv\")");
    let positions = [[2.5, 1.25, 1.1], [1.0, 2.123_456, 1.2], [3.0, 2.0, 0.9]];
    assert_eq!(walk.locations.iter().map(|location| location.pose.position).collect::<Vec<_>>(), positions);
    let listed = load(
        "listed.ron",
        &format!("Listed([{}])", rows.map(|row| format!("(position: ({row}), orientation: (0, 0, 0, 1))")).join(", ")),
    );
    let back = load("back.ron", "Csv(\"back.csv\")");
    for i in 0..3 {
        let pixels = |data: &Dataset, i: usize| data.observations.spectra().unwrap().image(i);
        assert_eq!(pixels(&walk, i), pixels(&listed, i));
        assert_eq!(pixels(&walk, i), pixels(&back, 2 - i), "{i}");
    }
}

#[test]
fn stated_poses_of_a_moving_receiver_keep_order_and_orientation() {
    let folder = tempfile::tempdir().unwrap();
    let text = scene_text("moving_receiver: (),")
        .replace("Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))", "Csv(\"rx_pose.csv\")");
    file(folder.path(), "rx_pose.csv", "x,y,z,qx,qy,qz,qw\n3,2,1.1,0,0,0.6,0.8\n1,2.5,1.2,0,0,0,1\n");
    let scene = SceneFile::read(&file(folder.path(), "moving.ron", &text)).unwrap();
    let fixed = SceneFile::parse(&scene_text(""), Path::new("fixed.ron")).unwrap();
    let poses = pwrfgs_data::read_poses(&folder.path().join("rx_pose.csv")).unwrap();
    assert_eq!(
        fixed.clone().with_receiver_poses(poses.clone(), Some(fixed.receiver.position)).unwrap(),
        SceneFile {
            transmitter: scene.transmitter.clone(),
            moving_receiver: scene.moving_receiver.clone(),
            ..fixed.clone()
        }
    );
    let source = format!("Simulated(scene: {:?}, points: 20, cache: false)", folder.path().join("moving.ron"));
    let data = Plugin::<dyn DataSource>::parse(&source).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
    assert_eq!(data.locations.iter().map(|location| location.pose).collect::<Vec<_>>(), poses);
    let refused = fixed.with_receiver_poses(poses.clone(), None).unwrap_err().to_string();
    assert!(refused.contains("its transmitter moves; add the position of a fixed one"), "{refused}");
}

#[test]
fn stated_positions_that_cannot_be_used_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let error = |positions: &str, csv: &str| {
        file(folder.path(), "walk.csv", csv);
        let text = scene_text("").replace("Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))", positions);
        let recipe = SimulationRecipe::read(&file(folder.path(), "s.ron", &text), 5, 0, 5);
        let error = recipe.and_then(|recipe| write(&recipe, OutputLayout::Array, false, &folder.path().join("out")));
        error.unwrap_err().to_string().replace(&folder.path().display().to_string(), "DIR")
    };
    let walk = "Csv(\"walk.csv\")";
    for (positions, csv, expected) in [
        (
            walk,
            "x,y,z\n1,2,1\n1.5,1.5,0.2\n",
            "scene `small`: transmitter 2 at (1.5, 1.5, 0.2) is inside `desk`; move the positions or",
        ),
        (walk, "x,y,z\n1,two,1\n", "DIR/walk.csv:2:3: `two` is not a number"),
        (walk, "x,y,z\n", "DIR/walk.csv: has a header but no row"),
        (walk, "x,y,z\n1,2e7,1\n", "the position [1.0, 20000000.0, 1.0] is too far away; give metres within 1000 km"),
        ("Csv(\"gone.csv\")", "", "cannot read DIR/gone.csv: no such file; write a table with the columns x, y, z"),
        ("Listed([])", "", "`positions` is empty; give at least one"),
        (
            "Listed([(position: (1, 2, 1), orientation: (0, 0, 0, 2))])",
            "",
            "the quaternion has length 2.000000, expected 1",
        ),
    ] {
        let message = error(positions, csv);
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn moving_receiver_has_spectra_of_fixed_receivers() {
    let folder = tempfile::tempdir().unwrap();
    let text = scene_text("moving_receiver: (turn_deg: 40),");
    let path = file(folder.path(), "moving.ron", &text);
    let source = format!("Simulated(scene: {path:?}, samples: 6, seed: 3, points: 20, cache: false)");
    let data = Plugin::<dyn DataSource>::parse(&source).unwrap().load(Path::new(""), &|_, _| {}).unwrap();
    let poses: Vec<Pose> = data.locations.iter().map(|location| location.pose).collect();
    assert!(poses.windows(2).all(|pair| pair[0].orientation != pair[1].orientation) && data.is_simulated());
    for (i, pose) in poses.into_iter().enumerate() {
        let mut scene = SceneFile::parse(&scene_text(""), Path::new("fixed.ron")).unwrap();
        let tx = scene.receiver.position;
        assert_eq!((data.scene.transmitter, data.scene.moving), (Some(tx), End::Receiver));
        let [x, y, z, w] = pose.orientation;
        (scene.receiver.position, scene.receiver.orientation) = (pose.position, Orientation::Quaternion(x, y, z, w));
        let simulator = Simulator::new(&scene).unwrap();
        let spectrum = spectrum(simulator.receivers()[0].observe(tx.into(), &ObservationKind::Spectrum, None));
        assert_eq!(*data.observations.raw(i), spectrum.pixels, "pose {i}");
        assert!(pose.turned([0.0, 1.0, 0.0])[2] > 0.999, "turned about the vertical axis only");
    }
    let refused = |layout, paths| {
        let recipe = SimulationRecipe::read(&path, 6, 3, 20).unwrap();
        let recipe = match layout {
            OutputLayout::Rssi => {
                recipe.observing(ObservationKind::Power { noise_db: 0.0 }).map_err(|e| e.to_string())?
            }
            _ => recipe,
        };
        write(&recipe, layout, paths, &folder.path().join("out")).map_err(|e| e.to_string())
    };
    assert!(refused(OutputLayout::Images, false).unwrap_err().contains("add --no-paths, and --npy for spectra"));
    assert!(refused(OutputLayout::Array, true).unwrap_err().contains("add --no-paths, and --npy for spectra"));
    refused(OutputLayout::Array, false).unwrap();
    let written = pwrfgs_data::read_poses(&folder.path().join("out/rx_pose.csv")).unwrap();
    assert_eq!(written.len(), 6);
    for (wrong, expected) in
        [("(turn_deg: 181)", "give degrees from 0 to 180"), ("(turn_deg: 4, x: 1)", "Unexpected field named `x`")]
    {
        let text = scene_text(&format!("moving_receiver: {wrong},"));
        let message = SceneFile::parse(&text, Path::new("wrong.ron")).unwrap_err().to_string();
        assert!(message.contains(expected) && message.contains("wrong.ron:13"), "{message}");
    }
}

#[test]
fn cached_data_set_is_used_only_if_complete() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(folder.path());
    let root = folder.path().join("cache");
    let simulated = AtomicUsize::new(0);
    let load = || {
        let count = |done, _| simulated.store(done, Ordering::Relaxed);
        let read = |entry: &Path| {
            let text = format!("Arrays(root: {:?}, points: {:?})", entry, entry.join(POINTS));
            Plugin::<dyn DataSource>::parse(&text).unwrap().load(Path::new(""), &|_, _| {})
        };
        let data = open_or_make(&recipe, Some(&root), &count, read).unwrap();
        let spectra: Vec<Vec<u8>> = (0..data.len()).map(|i| data.observations.raw(i).into_owned()).collect();
        (spectra, simulated.swap(0, Ordering::Relaxed) > 0)
    };
    let (truth, made) = load();
    assert!(made && truth.len() == 12);
    assert!(load() == (truth.clone(), false));
    let entry = root.join(recipe.folder_name());
    let damages: [&dyn Fn(); 4] = [
        &|| fs::remove_file(entry.join(MANIFEST)).unwrap(),
        &|| fs::write(entry.join(MANIFEST), recipe.to_json().replace("\"seed\": 7", "\"seed\": 8")).unwrap(),
        &|| {
            let spectra = entry.join("spectra.npy");
            let bytes = fs::read(&spectra).unwrap();
            fs::write(&spectra, &bytes[..bytes.len() / 2]).unwrap();
        },
        &|| fs::remove_file(entry.join(POINTS)).unwrap(),
    ];
    for damage in damages {
        damage();
        assert!(load() == (truth.clone(), true));
        assert!(load() == (truth.clone(), false));
    }
    // Remains of a killed program are not an entry.
    fs::rename(&entry, root.join(format!(".{}.x.tmp", recipe.folder_name()))).unwrap();
    assert!(load() == (truth.clone(), true));
    // Where nothing can be kept, the data are made all the same.
    let blocked = file(folder.path(), "blocked", "a file where the cache should be");
    let read = |entry: &Path| Ok(fs::read(entry.join("spectra.npy")).unwrap().len());
    assert!(open_or_make(&recipe, Some(&blocked), &|_, _| {}, read).unwrap() > 0);
}

#[test]
fn array_layout_equals_image_layout() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = recipe(folder.path());
    let load = |source: &str, layout| {
        let out = folder.path().join(source);
        write(&recipe, layout, false, &out).unwrap();
        let source = Plugin::<dyn DataSource>::parse(&format!("{source}(root: {out:?})")).unwrap();
        source.load(Path::new(""), &|_, _| {}).unwrap()
    };
    let [a, b] = [load("Nerf2Spectrum", OutputLayout::Images), load("Arrays", OutputLayout::Array)];
    assert!(b.is_simulated() && a.simulation == b.simulation && a.official == b.official);
    for i in 0..12 {
        assert!(a.observations.raw(i) == b.observations.raw(i) && a.sample(i).position() == b.sample(i).position());
    }
    // Names have five digits; an array has no names.
    let many = SimulationRecipe::read(&folder.path().join("small.ron"), 100_000, 0, 0).unwrap();
    let shown = write(&many, OutputLayout::Images, false, &folder.path().join("many")).unwrap_err();
    assert!(shown.is_input() && shown.to_string().contains("write one array with --npy"), "{shown}");
}

#[test]
fn simulates_shipped_scenes() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().join("scenes");
    for name in ["office", "conference", "lab-s23"] {
        let simulator = Simulator::new(&SceneFile::read(&root.join(format!("{name}.ron"))).unwrap()).unwrap();
        for tx in simulator.draw_positions(2, 0).unwrap() {
            let observation = simulator.receivers()[0].observe(tx, &ObservationKind::Spectrum, Some(0));
            assert!(observation.paths.len() > 50, "{name}: {} paths", observation.paths.len());
            let pixels = spectrum(observation).pixels;
            let (low, high) = (pixels.iter().min(), pixels.iter().max());
            assert_eq!((low, high), (Some(&0), Some(&255)), "{name}");
            assert!(simulator.world().check_free(tx).is_ok());
        }
        let points = simulator.surface_points(1000, 0);
        assert!(points.points.len() == 1000 && points.normals.len() == 1000);
    }
}

#[test]
fn accepts_niches_and_panels_aligned_with_walls() {
    let niche = "Plan(corners: [(0, 0), (1, 0), (1, -1), (2, -1), (2, 0), (4, 0), (4, 3), (0, 3)], ceiling: 2.5)";
    let text = scene_text("").replace("Box(low: (0, 0, 0), high: (4, 3, 2.5))", niche);
    let simulator = Simulator::new(&SceneFile::parse(&text, Path::new("niche.ron")).unwrap()).unwrap();
    assert_eq!(simulator.world().faces.len(), 8 + 2 + 5);
    // Two corners of the niche stand out into the room.
    let upright = |e: &&pwrfgs_raytrace::world::Edge| (e.ends[0].z - e.ends[1].z).abs() > 2.0;
    assert_eq!(simulator.world().edges.iter().filter(upright).count(), 2);
    let crossed = text.replace("(2, -1), (2, 0)", "(2, -1), (0.5, 0)");
    assert!(SceneFile::parse(&crossed, Path::new("s.ron")).unwrap_err().to_string().contains("cross or touch"));
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap().join("scenes");
    let conference = Simulator::new(&SceneFile::read(&root.join("conference.ron")).unwrap()).unwrap();
    assert!(conference.world().faces.iter().any(|f| f.name == "glass front"));
}

#[test]
fn parses_scene_of_simulator_page() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap();
    let page = fs::read_to_string(root.join("docs/simulator.md")).unwrap();
    let text = page.split("```ron\n").nth(1).unwrap().split("```").next().unwrap();
    let simulator = Simulator::new(&SceneFile::parse(text, Path::new("docs/simulator.md")).unwrap()).unwrap();
    assert_eq!(simulator.world().faces.len(), 6 + 5 + 1); // the underside of the crate lies on the floor
    assert_eq!(simulator.draw_positions(20, 0).unwrap().len(), 20);
}

#[test]
fn ray_tracing_in_exact_scene_reproduces_data() {
    let folder = tempfile::tempdir().unwrap();
    file(folder.path(), "small.ron", &scene_text(""));
    let source: Plugin<dyn DataSource> =
        Plugin::parse("Simulated(scene: \"small.ron\", samples: 10, points: 100, cache: false)").unwrap();
    let data = source.load(folder.path(), &|_, _| {}).unwrap();
    assert!(data.title.contains("simulated") && data.is_simulated());
    let predict = |text: &str, i: usize| {
        let baseline: Plugin<dyn Baseline> = Plugin::parse(text).unwrap();
        let predictor = baseline.fit(&data, FittingSet::default()).unwrap();
        assert!(predictor.is_oracle());
        (predictor.predict(data.query(i)), predictor.note())
    };
    for i in 0..10 {
        let (exact, note) = predict("RayTracing()", i);
        assert!(exact == data.image(i), "sample {i}");
        assert!(note.unwrap().contains("«RT exact» is the generator"));
        let (wrong, note) = predict("RayTracing(material_error: 0.3, position_error_m: 0.05)", i);
        assert!(wrong != data.image(i) && note.unwrap().contains("off by 30 % and positions by 5 cm"));
    }
    // Another scene is not that of the data; the same one is, wherever it was read from.
    let knows = |data: &Dataset, name: &str| {
        let scene = folder.path().join(name);
        let baseline: Plugin<dyn Baseline> = Plugin::parse(&format!("RayTracing(scene: {scene:?})")).unwrap();
        baseline.fit(data, FittingSet::default()).unwrap().is_oracle()
    };
    file(folder.path(), "other.ron", &scene_text("spectrum: Power,"));
    assert!(knows(&data, "small.ron") && !knows(&data, "other.ron"));
    let sheet = "Mesh(name: \"desk\", file: \"sheet.obj\", finish: (material: \"metal\", thickness_m: 0.001)";
    let desk = "Box(name: \"desk\", low: (1, 1, 0), high: (2, 2, 0.7), finish: (material: \"metal\")";
    file(folder.path(), "sheet.obj", "v 1 1 0\nv 2 1 0\nv 2 2 0\nf 1 2 3\n");
    let meshes = SceneFile::read(&file(folder.path(), "meshes.ron", &scene_text("").replace(desk, sheet))).unwrap();
    let elsewhere = Some(meshes.to_ron().replace(&folder.path().display().to_string(), "elsewhere"));
    let moved = Dataset { simulation: Some(Simulation { scene: elsewhere }), ..data.clone() };
    assert!(knows(&moved, "meshes.ron") && !knows(&moved, "small.ron"));
    // A folder that was written says from which scene.
    let out = folder.path().join("written");
    let recipe = SimulationRecipe::read(&folder.path().join("small.ron"), 10, 0, 100).unwrap();
    write(&recipe, OutputLayout::Images, false, &out).unwrap();
    let read = pwrfgs_data::Nerf2Spectrum { root: out, ..Default::default() }.load(Path::new(""), &|_, _| {}).unwrap();
    assert!(knows(&read, "small.ron") && !knows(&read, "other.ron"));
    let baseline: Plugin<dyn Baseline> = Plugin::parse("RayTracing()").unwrap();
    let exact = baseline.fit(&read, FittingSet::default()).unwrap();
    assert!(exact.is_oracle() && exact.predict(read.query(3)) == data.image(3));
    // Data that were not simulated need a scene by name.
    let measured = Dataset { simulation: None, ..data.clone() };
    assert!(!knows(&measured, "small.ron"));
    assert!(baseline.fit(&measured, FittingSet::default()).err().unwrap().to_string().contains("name one in `scene`"));
}

#[test]
fn reports_position_of_scene_errors() {
    let folder = tempfile::tempdir().unwrap();
    let error_of = |text: &str| {
        let error = SceneFile::read(&file(folder.path(), "s.ron", text)).and_then(|s| Simulator::new(&s).map(|_| ()));
        let error = error.unwrap_err();
        assert!(error.is_input());
        error.to_string().replace(&folder.path().display().to_string(), "DIR")
    };
    let plain = scene_text("");
    let cases = [
        ("\"metal\"", "\"metall\"", "DIR/s.ron:10:87: unknown material `metall`; did you mean `metal`?"),
        ("rows: 4", "rows: 0", "DIR/s.ron:11:"),
        ("carrier_hz: 2.4e9", "carrier_hz: 0", "DIR/s.ron:3:5: `carrier_hz` is 0"),
        ("carrier_hz", "carrier_ghz", "did you mean `carrier_hz`?"),
        ("(4, 3, 2.5)", "(4, 0, 2.5)", "DIR/s.ron:5:9: room: the box from"),
        ("position: (0.2, 1.5, 1.5)", "position: (1.5, 1.5, 0.3)", "the receiver at [1.5, 1.5, 0.3] is inside `desk`"),
        ("position: (0.2, 1.5, 1.5)", "position: (0.2, 1.5, 9)", "is outside the room"),
        ("thickness_m: 0.1", "thickness_m: -0.1", "walls: `thickness_m` is -0.1"),
        ("direction: (1, 0, 0)", "direction: (0, 0, 0)", "receiver: `direction` is [0.0, 0.0, 0.0]"),
        (
            "(material: \"metal\"))]",
            "(material: \"metal\")), Box(name: \"desk\", low: (0, 0, 0), high: (1, 1, 1), finish: (material: \"wood\"))]",
            "two objects are called `desk`",
        ),
        (
            "Box(name: \"desk\", low: (1, 1, 0), high: (2, 2, 0.7),",
            "Panel(name: \"desk\", from: (1, 1), to: (2, 2), heights: (0, 1),",
            "give its finish a `thickness_m`",
        ),
        ("low: (1, 1, 0), high: (2, 2, 0.7), finish", "file: \"no.obj\", finish", "unexpected"),
    ];
    for (from, to, expected) in cases {
        assert!(plain.contains(from), "{from}");
        let message = error_of(&plain.replacen(from, to, 1));
        assert!(message.to_lowercase().contains(&expected.to_lowercase()), "{to}: {message}");
    }
    let mesh = |file: &str| {
        plain.replace(
            "Box(name: \"desk\", low: (1, 1, 0), high: (2, 2, 0.7),",
            &format!("Mesh(name: \"desk\", file: \"{file}\","),
        )
    };
    file(folder.path(), "open.obj", "v 1 1 0\nv 2 1 0\nv 2 2 0\nv 1 1 1\nf 1 2 3\nf 1 2 4\n");
    file(folder.path(), "flat.obj", "v 1 1 0\nv 2 1 0\nv 3 1 0\nf 1 2 3\n");
    assert!(error_of(&mesh("open.obj")).contains("DIR/open.obj: the surface of `desk` is open"));
    assert!(error_of(&mesh("flat.obj")).contains("holds no triangle with an area"));
    assert!(error_of(&mesh("gone.obj")).contains("cannot read DIR/gone.obj"));
    // A thin sheet may be open.
    let sheet = mesh("open.obj").replace("(material: \"metal\")", "(material: \"metal\", thickness_m: 0.001)");
    let scene = SceneFile::read(&file(folder.path(), "s.ron", &sheet)).unwrap();
    assert_eq!(Simulator::new(&scene).unwrap().world().faces.len(), 6 + 2);
}

#[test]
fn transmitters_are_outside_objects() {
    let folder = tempfile::tempdir().unwrap();
    let in_desk = scene_text("").replace(
        "Uniform(low: (0.9, 0.9, 0.4), high: (3.5, 2.5, 1.5))",
        "Grid(low: (0.9, 0.9, 0.1), high: (2.1, 2.1, 0.7), step_m: 0.3)",
    );
    let scene = SceneFile::read(&file(folder.path(), "s.ron", &in_desk)).unwrap();
    let message = Simulator::new(&scene).unwrap().draw_positions(5, 0).unwrap_err();
    assert!(message.is_input() && message.to_string().contains("inside `desk`"), "{message}");
    let free = Simulator::new(&SceneFile::read(&file(folder.path(), "s.ron", &scene_text(""))).unwrap()).unwrap();
    let desk = |p: &DVec3| p.x > 1.0 && p.x < 2.0 && p.y > 1.0 && p.y < 2.0 && p.z < 0.7;
    assert!(!free.draw_positions(200, 3).unwrap().iter().any(desk));
}

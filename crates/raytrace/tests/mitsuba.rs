//! Mitsuba scenes, as of Sionna RT: import, its errors, and export.

use glam::DVec3;
use pwrfgs_core::plugin::Checked;
use pwrfgs_core::{Baseline, DataSource};
use pwrfgs_raytrace::scene::Propagation;
use pwrfgs_raytrace::{Interaction, PropagationPath, RayTracing, SceneFile, Simulated, Simulator, mitsuba};
use std::fs;
use std::path::Path;

/// Square of 4 m at z = 0.
const PLATE: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    element face 2\nproperty list uchar int vertex_indices\nend_header\n-2 -2 0\n2 -2 0\n2 2 0\n-2 2 0\n3 0 1 2\n3 0 2 3\n";
/// Cube between -1 and 1.
const CUBE: &str = "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n\
    f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
const GLASS: &str = "<bsdf type=\"itu-radio-material\" id=\"wall\">\n<string name=\"type\" value=\"glass\"/>\n\
    <float name=\"thickness\" value=\"0.05\"/>\n</bsdf>";
const SHAPE: &str = "<shape type=\"ply\" id=\"plate\">\n<string name=\"filename\" value=\"meshes/plate.ply\"/>\n\
    <boolean name=\"face_normals\" value=\"true\"/>\n<ref id=\"wall\" name=\"bsdf\"/>\n</shape>";
const TEXTURED: &str = "<bsdf type=\"radio-material\" id=\"wall\"><texture type=\"bitmap\"/></bsdf>";
const TX: DVec3 = DVec3::new(-0.5, 0.23, 1.0);

/// Creates a folder with both meshes and the file `scene.xml` of these elements.
fn folder(elements: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("meshes")).unwrap();
    fs::write(folder.path().join("meshes/plate.ply"), PLATE).unwrap();
    fs::write(folder.path().join("meshes/cube.obj"), CUBE).unwrap();
    fs::write(folder.path().join("scene.xml"), format!("<scene version=\"2.1.0\">\n{elements}\n</scene>\n")).unwrap();
    folder
}

/// Reads a scene with that file, with a receiver at (0.6, -0.1, 1.5) and these settings.
fn scene(elements: &str, more: &str) -> SceneFile {
    let folder = folder(elements);
    let text = format!(
        "(name: \"s\", carrier_hz: 3e9, mitsuba: \"scene.xml\", {more}
          receiver: (position: (0.6, -0.1, 1.5), orientation: Facing(direction: (1, 0, 0)), array: (rows: 1, columns: 1)),
          transmitter: (positions: Uniform(low: (-1, -1, 1), high: (1, 1, 2))))"
    );
    fs::write(folder.path().join("s.ron"), text).unwrap();
    let mut scene = SceneFile::read(&folder.path().join("s.ron")).unwrap();
    scene.receiver.name = "kept".into();
    std::mem::forget(folder); // the meshes are read when the scene is traced
    scene
}

/// Returns the paths from [`TX`].
fn traced(scene: &SceneFile) -> Vec<PropagationPath> {
    Simulator::new(scene).unwrap().trace(TX)
}

#[test]
fn open_scene_has_line_of_sight_reflection_and_four_rims() {
    let simulator = Simulator::new(&scene(&format!("{GLASS}{SHAPE}"), "")).unwrap();
    let (world, paths) = (simulator.world(), simulator.trace(TX));
    assert_eq!((world.faces.len(), world.edges.len()), (1, 4), "coplanar triangles are one face");
    let specular: Vec<_> = paths.iter().filter(|path| !path.interactions.iter().any(is_diffraction)).collect();
    assert_eq!((specular.len(), paths.len()), (2, 6));
    let image = TX.with_z(-1.0);
    assert!((specular[1].length - image.distance(DVec3::new(0.6, -0.1, 1.5))).abs() < 1e-12);
    assert!(simulator.world().check_free(DVec3::splat(500.0)).is_ok(), "no room has an outside");
}

/// Returns whether an interaction is a diffraction.
fn is_diffraction(interaction: &Interaction) -> bool {
    matches!(interaction, Interaction::Diffraction { .. })
}

#[test]
fn three_spellings_of_a_material_give_equal_paths() {
    let glass = traced(&scene(&format!("{GLASS}{SHAPE}"), ""));
    let (eta, sigma) = pwrfgs_raytrace::material::itu_material("glass").unwrap().constants(3e9);
    let constants = format!(
        "<bsdf type=\"radio-material\" id=\"glass\"><float name=\"relative_permittivity\" value=\"{eta}\"/>\
         <float name=\"conductivity\" value=\"{sigma}\"/><float name=\"thickness\" value=\"0.05\"/></bsdf>"
    );
    let old = "<bsdf type=\"twosided\" id=\"mat-itu_glass\"><bsdf type=\"diffuse\"><texture type=\"bitmap\"/></bsdf>\
               <float name=\"thickness\" value=\"0.05\"/></bsdf>";
    let inside = SHAPE.replace("<ref id=\"wall\" name=\"bsdf\"/>", GLASS);
    for (material, shape) in [
        (&*constants, SHAPE.replace("\"wall\"", "\"glass\"")),
        (old, SHAPE.replace("\"wall\"", "\"mat-itu_glass\"")),
        ("", inside),
    ] {
        let paths = traced(&scene(&format!("{shape}{material}"), "")); // materials may follow shapes
        assert_eq!(paths.len(), glass.len(), "{material}");
        let equal = |(a, b): (&PropagationPath, &PropagationPath)| (a.gain - b.gain).norm() < 1e-12 * b.gain.norm();
        assert!(paths.iter().zip(&glass).all(equal), "{material}");
    }
}

#[test]
fn radio_material_with_id_of_itu_has_constants_of_itu() {
    let finish = |id: &str| {
        let constant = "<float name=\"relative_permittivity\" value=\"5\"/>";
        let material = format!("<bsdf type=\"radio-material\" id=\"{id}\">{constant}</bsdf>");
        let scene = scene(&format!("{material}{}", SHAPE.replace("wall", id)), "");
        scene.objects[0].finish().unwrap().material.clone()
    };
    assert_eq!(finish("mat-itu_glass"), "glass");
    assert_eq!(finish("itu_glass"), "glass");
    assert_eq!(finish("glass"), "glass (radio-material)");
    assert_eq!(finish("mat-itu_mine"), "mat-itu_mine");
}

#[test]
fn materials_of_scene_file_have_precedence_over_those_of_xml_file() {
    let materials = "materials: { \"wall\": (a: 4, c: 0.1), \"itu_glass\": (a: 3, c: 0) },";
    for (kind, id, expected) in [
        ("diffuse", "wall", "wall"),
        ("diffuse", "mat-wall", "wall"),
        ("twosided", "mat-itu_glass", "itu_glass"),
        ("radio-material", "wall", "wall"),
        ("diffuse", "mat-itu_wood", "wood"),
    ] {
        let bsdf = format!("<bsdf type=\"{kind}\" id=\"{id}\"><float name=\"thickness\" value=\"0.2\"/></bsdf>");
        let scene = scene(&format!("{bsdf}{}", SHAPE.replace("id=\"wall\"", &format!("id=\"{id}\""))), materials);
        let finish = scene.objects[0].finish().unwrap();
        assert_eq!((&*finish.material, finish.thickness_m), (expected, Some(0.2)), "{kind} {id}");
    }
}

#[test]
fn cubes_and_rectangles_are_placed_by_their_transforms() {
    let shape = |kind: &str, id: &str, steps: &str| {
        let reference = "<ref id=\"wall\" name=\"bsdf\"/>";
        format!(
            "<shape type=\"{kind}\" id=\"{id}\"><transform name=\"to_world\">{steps}</transform>{reference}</shape>"
        )
    };
    let cube = shape("cube", "crate", "<scale x=\"0.5\" y=\"2\" z=\"1.5\"/><translate x=\"3\" z=\"1.6\"/>");
    let floor = |id: &str, more: &str| shape("rectangle", id, &format!("<scale x=\"5\" y=\"4\"/>{more}"));
    let plates = floor("floor", "") + &floor("low", "<translate z=\"-1\"/>");
    for (shapes, triangles, area) in [(floor("floor", "") + &cube, 14, 118.0), (plates, 4, 160.0)] {
        let scene = scene(&format!("{GLASS}{shapes}"), "");
        let world = Simulator::new(&scene).unwrap();
        let world = world.world();
        let sum: f64 = world.triangles.iter().map(pwrfgs_raytrace::world::Triangle::area).sum();
        assert!(world.triangles.len() == triangles && (sum - area).abs() < 1e-9, "{} {sum}", world.triangles.len());
        let saved = SceneFile::parse(&scene.to_ron(), Path::new("saved.ron")).unwrap();
        assert_eq!(Simulator::new(&saved).unwrap().world().triangles.len(), triangles, "needs no file");
    }
}

#[test]
fn alias_names_a_material_again_and_unused_materials_are_ignored() {
    let visual = "<bsdf type=\"twosided\" id=\"default-bsdf\"><bsdf type=\"diffuse\"/></bsdf>";
    let alias = "<alias id=\"wall\" as=\"second\"/><alias id=\"second\" as=\"third\"/>";
    let shape = SHAPE.replace("id=\"wall\"", "id=\"third\"");
    let scene = scene(&format!("{visual}{GLASS}{alias}{SHAPE}{}", shape.replace("id=\"plate\"", "id=\"other\"")), "");
    assert_eq!(scene.objects.iter().map(|o| &*o.finish().unwrap().material).collect::<Vec<_>>(), ["glass"; 2]);
}

#[test]
fn objects_of_scene_file_may_have_materials_of_xml_file() {
    let foam = "<bsdf type=\"radio-material\" id=\"foam\"><float name=\"relative_permittivity\" value=\"1.1\"/></bsdf>";
    let shape = SHAPE.replace("\"wall\"", "\"foam\"");
    let panel = "objects: [Panel(name: \"w\", from: (5, 0), to: (5, 4), heights: (0, 3), finish: (material: \"foam\", thickness_m: 0.1))],";
    let scene_with_foam = scene(&format!("{foam}{shape}"), panel);
    assert_eq!(
        scene_with_foam.objects.iter().map(|object| &*object.finish().unwrap().material).collect::<Vec<_>>(),
        ["foam"; 2]
    );
}

#[test]
fn material_without_thickness_has_ten_centimetres_as_in_sionna() {
    let thin = GLASS.replace("<float name=\"thickness\" value=\"0.05\"/>", "");
    let scene = scene(&format!("{thin}{SHAPE}"), "");
    assert_eq!(scene.objects[0].finish().unwrap().thickness_m, Some(0.1));
}

#[test]
fn variables_and_transforms_place_a_mesh() {
    let transformed =
        |inner: &str| SHAPE.replace("</shape>", &format!("<transform name=\"to_world\">{inner}</transform></shape>"));
    let defaults = "<default name=\"h\" value=\"-0.5\"/><default name=\"high\" value=\"90\"/>";
    let steps = "<scale value=\"0.5\"/><rotate x=\"1\" angle=\"$high\"/><translate z=\"$h\" x=\"1.5\"/>";
    let matrix = "<matrix value=\"0.5 0 0 1.5, 0 0 -0.5 0, 0 0.5 0 -0.5, 0 0 0 1\"/>";
    let corners = |inner: &str| {
        let text = format!("{defaults}{GLASS}{}", transformed(inner));
        Simulator::new(&scene(&text, "")).unwrap().world().faces[0].hull.clone()
    };
    let expected = [(0.5, -1.5), (2.5, -1.5), (2.5, 0.5), (0.5, 0.5)].map(|(x, z)| DVec3::new(x, 0.0, z));
    let three = "<matrix value=\"0.5 0 0, 0 0 -0.5, 0 0.5 0\"/><translate z=\"$h\" x=\"1.5\"/>";
    for inner in [steps, matrix, three] {
        let hull = corners(inner);
        let is_corner = |p: &DVec3| hull.iter().any(|q| p.distance(*q) < 1e-12);
        assert!(hull.len() == 4 && expected.iter().all(is_corner), "{hull:?}");
    }
}

#[test]
fn hollow_cube_holds_antennas_and_has_paths_of_a_room() {
    let cube = SHAPE.replace("\"ply\"", "\"obj\"").replace("plate.ply", "cube.obj");
    let inside = cube.replace("</shape>", "<transform name=\"to_world\"><scale value=\"2\"/></transform></shape>");
    let imported = scene(&format!("{GLASS}{inside}"), "propagation: (order: 2, room_order: 2),");
    let finish = "(material: \"glass\", thickness_m: 0.05)";
    let room = format!(
        "room: (outline: Box(low: (-2, -2, -2), high: (2, 2, 2)), walls: {finish}, floor: {finish}, ceiling: {finish})"
    );
    let mut text = imported.to_ron().replace("    objects: [", &format!("    {room},\n    objects: ["));
    let (start, end) = (text.find("objects: [").unwrap(), text.find("receiver:").unwrap());
    text.replace_range(start..end, "");
    let room = SceneFile::parse(&text, Path::new("room.ron")).unwrap();
    assert_equal_paths(&traced(&imported), &traced(&room), 1e-9);
    assert_eq!(traced(&imported).len(), 1 + 6 + 18, "one path per image of second order");
}

/// Compares two lists of paths in any order: lengths, arrivals and gains relative to the strongest.
fn assert_equal_paths(one: &[PropagationPath], other: &[PropagationPath], tolerance: f64) {
    assert_eq!(one.len(), other.len());
    let strongest = one.iter().map(|path| path.gain.norm()).fold(0.0, f64::max);
    for a in one {
        let is_equal = |b: &PropagationPath| {
            (a.length - b.length).abs() < tolerance
                && a.arrival.distance(b.arrival) < tolerance
                && (a.gain - b.gain).norm() < tolerance * strongest
        };
        assert!(other.iter().any(is_equal), "{a:?}");
    }
}

#[test]
fn exported_scenes_have_equal_paths() {
    let scenes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
    for name in ["conference", "lab-s23", "office"] {
        let mut scene = SceneFile::read(&scenes.join(format!("{name}.ron"))).unwrap();
        scene.propagation = Checked::new(Propagation { room_order: 2, ..Propagation::default() }).unwrap();
        scene.room.as_mut().unwrap().ceiling.roughness = None;
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("out");
        let meshes = mitsuba::export_scene(&scene, &out).unwrap();
        assert_eq!(meshes, 3 + scene.objects.len(), "{name}");
        let text = fs::read_to_string(out.join("scene.xml")).unwrap();
        assert_eq!(text.matches("<shape").count(), meshes);
        let mut bare =
            SceneFile { room: None, objects: Vec::new(), mitsuba: Some("scene.xml".into()), ..scene.clone() };
        bare.materials.clear();
        fs::write(out.join("back.ron"), bare.to_ron()).unwrap();
        let back = SceneFile::read(&out.join("back.ron")).unwrap();
        let (before, after) = (Simulator::new(&scene).unwrap(), Simulator::new(&back).unwrap());
        for tx in before.draw_positions(5, 1).unwrap() {
            assert_equal_paths(&before.trace(tx), &after.trace(tx), 1e-9);
        }
        assert!(mitsuba::export_scene(&scene, &out).unwrap_err().is_input(), "an existing folder is kept");
    }
}

#[test]
fn xml_alone_has_default_antennas_around_its_meshes() {
    let folder = folder(&format!("{GLASS}{SHAPE}"));
    let scene = SceneFile::read(&folder.path().join("scene.xml")).unwrap();
    assert_eq!(scene.name, folder.path().file_name().unwrap().to_string_lossy(), "the folder of scene.xml");
    assert_eq!((scene.carrier_hz, scene.receiver.position), (3.5e9, [0.0, 0.0, 1.5]));
    assert_eq!(scene.transmitter.positions.corners(), ([-1.6, -1.6, 1.5], [1.6, 1.6, 1.5]));
    let moved = scene.with_overrides(Some(2e9), Some([0.0, 0.0, 3.0])).unwrap();
    assert_eq!((moved.carrier_hz, moved.receiver.position), (2e9, [0.0, 0.0, 3.0]));
    assert!(moved.with_overrides(Some(0.0), None).unwrap_err().to_string().contains("`carrier_hz` is 0"));
    let upright =
        "<transform name=\"to_world\"><matrix value=\"0 0 1 0 0 1 0 0 1 0 0 0 0 0 0 1\"/></transform></shape>";
    let wall = format!("<scene>{GLASS}{}</scene>", SHAPE.replace("</shape>", upright));
    fs::write(folder.path().join("scene.xml"), wall).unwrap();
    let refused = SceneFile::read(&folder.path().join("scene.xml")).unwrap_err().to_string();
    assert!(refused.contains("a single wall has no default antennas; name the XML file"), "{refused}");
}

#[test]
fn xml_is_a_scene_of_simulated_data_and_of_their_baseline() {
    let folder = folder(&format!("{GLASS}{SHAPE}"));
    let source = Simulated { scene: "scene.xml".into(), samples: 6, points: 40, cache: false, ..Simulated::default() };
    let data = source.load(folder.path(), &|_, _| {}).unwrap();
    assert!(data.title.ends_with(" (simulated)") && (data.len(), data.scene.points.len()) == (6, 40), "{}", data.title);
    let oracle = RayTracing { position_error_m: 0.01, material_error: 0.1, ..RayTracing::default() };
    oracle.check_data(&data).unwrap(); // an open scene can be perturbed
}

#[test]
fn errors_name_line_column_and_next_step() {
    let sound = format!("{GLASS}\n{SHAPE}");
    let transform = |inner: &str| format!("<transform name=\"to_world\">{inner}</transform></shape>");
    for (from, to, expected) in [
        ("plate.ply", "chair.ply", "scene.xml:7:1: mesh `meshes/chair.ply` is missing: paths begin in the folder"),
        ("itu-radio-material", "diffuse", "scene.xml:2:1: material `wall` of type `diffuse` is not a radio material"),
        ("itu-radio-material", "diffuse", "rename it to `itu_concrete`"),
        ("\"glass\"", "\"glas\"", "scene.xml:3:1: unknown ITU material `glas`; did you mean `glass`?"),
        ("\"thickness\"", "\"thicknes\"", "scene.xml:4:1: unknown property `thicknes`; did you mean `thickness`?"),
        ("\"0.05\"", "\"thin\"", "scene.xml:4:1: `value`: `thin` is not a finite number"),
        ("\"0.05\"", "\"0\"", "scene.xml:4:1: `thickness` must be a number from"),
        ("\"ply\"", "\"sphere\"", "scene.xml:6:1: unsupported shape type `sphere`; export the shape as a PLY mesh"),
        ("<ref id=\"wall\"", "<ref id=\"wal\"", "scene.xml:9:1: unknown material `wal`; did you mean `wall`?"),
        ("<ref id=\"wall\" name=\"bsdf\"/>", "", "scene.xml:6:1: the shape has no material; add <ref"),
        ("value=\"0.05\"", "value=\"$d\"", "scene.xml:4:1: unknown variable `$d`; add a `default`"),
        (GLASS, TEXTURED, "scene.xml:2:39: unsupported texture: a radio material is constant"),
        (
            "</bsdf>",
            "</bsfd>",
            "scene.xml:5:1: invalid XML: expected 'bsdf' tag, not 'bsfd' at 5:1; export the scene again",
        ),
        ("</shape>", "</shape><include filename=\"b.xml\"/>", "unsupported element `include`; put its shapes"),
        ("</shape>", "<transform name=\"toWorld\"/></shape>", "rename the transform `to_world`"),
        ("</shape>", &transform("<lookat/>"), "unsupported transform; use translate, scale, rotate or matrix"),
        ("</shape>", &transform("<rotate angle=\"5\"/>"), "`rotate` needs an axis x, y or z"),
        ("</shape>", &transform("<matrix value=\"1 2\"/>"), "`matrix` needs 16 numbers"),
        ("</shape>", &transform("<matrix value=\"1 2 3 4 5 6 7 8\"/>"), "or 9 without translation"),
        ("</shape>", &transform("<scale value=\"0\"/>"), "plate.ply: triangle 1 at (0, 0, 0) has no area"),
        (SHAPE, "", "scene.xml:1:1: the scene has no `shape`"),
        ("<shape type", &format!("{GLASS}<shape type"), "two materials have the id `wall`; rename one"),
        ("<shape type", &format!("{SHAPE}<shape type"), "two objects are called `plate`; give each a unique name"),
    ] {
        assert!(sound.contains(from), "{from}");
        let folder = folder(&sound.replacen(from, to, 1));
        let read = SceneFile::read(&folder.path().join("scene.xml")).and_then(|scene| Simulator::new(&scene).map(drop));
        let error = read.expect_err(to);
        assert!(error.is_input() && error.to_string().contains(expected), "{to}: {error}");
    }
    let bomb = format!(
        "<default name=\"a\" value=\"{}\"/><bsdf type=\"radio-material\" id=\"{}\"/>{SHAPE}",
        "x".repeat(1_000),
        "$a".repeat(1_000_000)
    );
    let error = SceneFile::read(&folder(&bomb).path().join("scene.xml")).unwrap_err().to_string();
    assert!(error.contains("`id` is longer than 1,000 characters; shorten it") && error.len() < 500, "{error}");
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("a.xml"), "<mesh/>").unwrap();
    let error = SceneFile::read(&folder.path().join("a.xml")).unwrap_err().to_string();
    assert!(error.contains("a.xml:1:1: this is not a Mitsuba scene"), "{error}");
}

#[test]
fn text_that_exhausts_memory_or_time_is_rejected_at_once() {
    let list = |count: usize, element: fn(usize) -> String| (0..count).map(element).collect::<String>();
    let value = "A".repeat(1_000);
    let variable = |name: &str| format!("<default name=\"{name}\" value=\"{value}\"/>");
    let material = |id: &str| format!("<bsdf type=\"radio-material\" id=\"{id}\"/>");
    let small = format!("<default name=\"ab\" value=\"{}\"/><default name=\"a\" value=\"\"/>", &value[1..]);
    for (elements, expected) in [
        (
            variable("a") + "\n" + &material("$a1"),
            "scene.xml:3:1: `id` is longer than 1,000 characters; shorten it or its",
        ),
        (variable("a") + &material(&"$a".repeat(490)), "scene.xml:2:1029: `id` is longer than 1,000 characters"),
        (small.clone() + &material("$ab$a12"), "`id` is longer than 1,000 characters"),
        (small + &material("$ab$a1"), "the scene has no `shape`"),
        (list(101, |i| format!("\n<default name=\"v{i}\" value=\"1\"/>")), "scene.xml:103:1: `default` needs a `name`"),
        (format!("\n <a {}/>", list(20_000, |i| format!("a{i}=\"1\" "))), "scene.xml:3:2: more than 100 attributes"),
        (format!("<a {}/>", list(20_000, |i| format!("xmlns:a{i}=\"u\" "))), "scene.xml:2:1: more than 100 attributes"),
        (list(20_000, |i| format!("<a xmlns:b{i}=\"u\">\n")), "scene.xml:102:1: more than 100 namespaces"),
        ("<a/>".repeat(500_000), "scene.xml:2:1999997: more than 500000 tags; cut out a part"),
    ] {
        let (folder, begun) = (folder(&elements), std::time::Instant::now());
        let error = SceneFile::read(&folder.path().join("scene.xml")).unwrap_err();
        assert!(error.is_input() && error.to_string().contains(expected), "{expected}: {error}");
        assert!(begun.elapsed().as_secs() < 5, "{expected}: {:?}", begun.elapsed());
    }
}

#[test]
fn shapes_of_one_mesh_count_towards_the_limit_of_triangles() {
    let triangle = |i: usize| format!("v {i} 0 0\nv {i} 1 0\nv {i} 0 1\nf {} {} {}\n", 3 * i + 1, 3 * i + 2, 3 * i + 3);
    let shape = |i: usize| {
        SHAPE.replace("\"plate\"", &format!("\"{i}\"")).replace("plate.ply", "many.obj").replace("\"ply\"", "\"obj\"")
    };
    let folder = folder(&format!("{GLASS}{}", (0..400).map(shape).collect::<String>()));
    fs::write(folder.path().join("meshes/many.obj"), (0..1_000).map(triangle).collect::<String>()).unwrap();
    let error = SceneFile::read(&folder.path().join("scene.xml")).unwrap_err();
    assert!(error.is_input() && error.to_string().contains("the shapes have more than 300000 triangles"), "{error}");
}

#[test]
fn scene_without_surfaces_and_opening_in_export_are_rejected() {
    let text =
        "(name: \"e\", carrier_hz: 1e9, receiver: (position: (0, 0, 0), orientation: Facing(direction: (1, 0, 0))),
        transmitter: (positions: Uniform(low: (1, 1, 1), high: (2, 2, 2))))";
    let empty = SceneFile::parse(text, Path::new("e.ron")).unwrap_err().to_string();
    assert!(empty.contains("e.ron:1:") && empty.contains("give it a `room`, `objects` or `mitsuba`"), "{empty}");
    let wall = "objects: [Panel(name: \"w\", from: (5, 0), to: (5, 4), heights: (0, 3), finish: (material: \"wood\", \
        thickness_m: 0.1)), Opening(name: \"door\", from: (5, 1), to: (5, 2), heights: (0, 2))], receiver";
    let open = SceneFile::parse(&text.replacen("receiver", wall, 1), Path::new("o.ron")).unwrap();
    Simulator::new(&open).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let refused = mitsuba::export_scene(&open, &folder.path().join("out")).unwrap_err().to_string();
    assert!(refused.contains("opening `door` cannot be exported; remove it"), "{refused}");
    assert!(!folder.path().join("out").exists());
}

//! A cube in every file format, and errors of invalid surfaces.

use super::*;
use crate::scene::SceneFile;
use proptest::prelude::*;
use pwrfgs_core::testing::shared;

/// The unit cube of six squares, outside counterclockwise, as OBJ.
const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
    f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

/// Reads a mesh file with this content; the folder in errors is `DIR`.
fn read_text(name: &str, text: &[u8]) -> Result<Mesh, String> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, text).unwrap();
    read_mesh(&path).map_err(|e| e.to_string().replace(&folder.path().display().to_string(), "DIR"))
}

fn cube() -> Mesh {
    read_text("cube.obj", CUBE.as_bytes()).unwrap()
}

impl Mesh {
    /// Returns the corners of all triangles.
    fn all_corners(&self) -> Vec<[DVec3; 3]> {
        self.triangles.iter().map(|triangle| self.corners(*triangle)).collect()
    }

    /// Returns the number of edges of more than two triangles, as between touching bodies or for duplicate triangles.
    fn crowded_edges(&self) -> usize {
        self.triangles_per_edge().filter(|triangles| *triangles > 2).count()
    }
}

/// Returns the volume by the divergence theorem.
fn volume(mesh: &Mesh) -> f64 {
    mesh.all_corners().iter().map(|[a, b, c]| a.dot(b.cross(*c)) / 6.0).sum()
}

fn area(mesh: &Mesh) -> f64 {
    mesh.all_corners().iter().map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum()
}

/// Returns the OBJ file in which every triangle has separate vertices.
fn separate_triangles(mesh: &Mesh) -> String {
    let facet = |(k, t): (usize, &[DVec3; 3])| {
        let vertices = t.map(|v| format!("v {} {} {}\n", v.x, v.y, v.z)).concat();
        format!("{vertices}f {} {} {}\n", 3 * k + 1, 3 * k + 2, 3 * k + 3)
    };
    mesh.all_corners().iter().enumerate().map(facet).collect()
}

#[test]
fn cube_is_closed_and_has_its_volume_in_every_format() {
    let cube = cube();
    let separate = read_text("separate.obj", separate_triangles(&cube).as_bytes()).unwrap();
    let mut ply = "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n\
        element face 6\nproperty list uchar int vertex_indices\nend_header\n"
        .to_owned();
    let row = |line: &str| {
        let numbers: Vec<i32> = line.split(' ').skip(1).map(|word| word.parse().unwrap()).collect();
        match line.as_bytes()[0] {
            b'v' => format!("{} {} {}\n", numbers[0], numbers[1], numbers[2]),
            _ => format!("4 {} {} {} {}\n", numbers[0] - 1, numbers[1] - 1, numbers[2] - 1, numbers[3] - 1),
        }
    };
    ply.extend(CUBE.lines().map(row));
    let ply = read_text("cube.ply", ply.as_bytes()).unwrap();
    for mesh in [&cube, &separate, &ply] {
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8, 12));
        assert_eq!((mesh.boundary_edge_count(), mesh.crowded_edges()), (0, 0));
        assert!(mesh.is_closed());
        assert_eq!(area(mesh), 6.0);
        assert!((volume(mesh) - 1.0).abs() < 1e-15);
        assert_eq!(mesh.all_corners(), cube.all_corners());
    }
    assert_eq!(separate, cube, "welding numbers the vertices by first use, whatever the file");
}

#[test]
fn open_and_duplicate_surfaces_are_not_closed() {
    let mut open = cube();
    open.triangles.truncate(10);
    assert_eq!((open.boundary_edge_count(), open.crowded_edges(), open.is_closed()), (4, 0, false));
    let mut fin = cube();
    fin.triangles.push(fin.triangles[0]);
    assert_eq!((fin.boundary_edge_count(), fin.crowded_edges(), fin.is_closed()), (0, 3, false));
    assert!(!Mesh::default().is_closed());
}

#[test]
fn bodies_with_shared_edge_are_closed() {
    let cube = cube();
    let mut both = cube.clone();
    let beside = cube.transformed(1.0, 0.0, DVec3::new(1.0, 1.0, 0.0));
    both.triangles.extend(beside.triangles.iter().map(|t| t.map(|v| v + 8)));
    both.vertices.extend(beside.vertices);
    let both = both.welded();
    assert_eq!(both.vertices.len(), 14);
    assert_eq!((both.boundary_edge_count(), both.crowded_edges(), both.is_closed()), (0, 1, true));
}

#[test]
fn welding_drops_unused_vertices_and_keeps_faults() {
    let vertices = [9.0, 1.0, 0.0, 1.0, -0.0].map(DVec3::splat).to_vec();
    let mesh = Mesh { vertices, triangles: vec![[1, 2, 7], [3, 4, 1]] }.welded();
    assert_eq!(mesh, Mesh { vertices: vec![DVec3::ONE, DVec3::ZERO], triangles: vec![[0, 1, 7], [0, 1, 0]] });
}

#[test]
fn mesh_is_scaled_then_rotated_then_shifted() {
    let shift = DVec3::new(10.0, 20.0, 30.0);
    let moved = Mesh { vertices: vec![DVec3::new(1.0, 0.0, 1.0)], triangles: vec![] };
    assert_eq!(moved.clone().transformed(2.0, 90.0, shift).vertices, [DVec3::new(10.0, 22.0, 32.0)]);
    assert_eq!(moved.clone().transformed(2.0, -180.0, shift).vertices, [DVec3::new(8.0, 20.0, 32.0)]);
    assert_eq!(moved.clone().transformed(2.0, 630.0, shift).vertices, [DVec3::new(10.0, 18.0, 32.0)]);
    let turned = moved.transformed(1.0, 30.0, DVec3::ZERO).vertices[0];
    assert!(turned.distance(DVec3::new(0.75f64.sqrt(), 0.5, 1.0)) < 1e-15);
    assert!((volume(&cube().transformed(-2.0, 200.0, shift)) - 8.0).abs() < 1e-9, "outside stays outside");
}

#[test]
fn reports_invalid_surfaces() {
    let sample = |text: &str| read_text("a.obj", text.as_bytes()).unwrap_err();
    let empty = "DIR/a.obj: holds no triangle with an area; export a surface with faces";
    assert_eq!(sample("v 0 0 0\n"), empty);
    let v = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 2 1e-9 0\nv 0 0 0\n";
    for face in ["1 2 3", "1 2 2", "1 2 5", "1 6 4"] {
        let mesh = read_text("a.obj", format!("{v}f 1 2 4\nf {face}\n").as_bytes()).unwrap();
        assert_eq!(area(&mesh), 0.5, "a triangle without area is left out");
        assert_eq!(sample(&format!("{v}f {face}\n")), empty);
    }
    assert!(read_text("a.obj", format!("{v}v 2 1e-6 0\nf 1 2 7\n").as_bytes()).is_ok(), "a sliver is a triangle");
    let by_hand = |vertices: Vec<DVec3>, triangle: [u32; 3]| {
        Mesh { vertices, triangles: vec![triangle] }.check(Path::new("a")).unwrap_err().to_string()
    };
    let flat = by_hand(vec![DVec3::ZERO, DVec3::X, 2.0 * DVec3::X], [0, 1, 2]);
    assert_eq!(flat, "a: triangle 1 at (0, 0, 0) has no area; remove degenerate faces in the modelling program");
    let corners = vec![DVec3::ZERO, DVec3::X, DVec3::new(0.0, f64::NAN, 0.0)];
    assert_eq!(
        by_hand(corners.clone(), [0, 1, 3]),
        "a: triangle 1 names vertex 3 of 3, counted from 0; correct the index"
    );
    assert_eq!(
        by_hand(corners, [0, 1, 2]),
        "a: triangle 1 has a vertex that is not finite; give every vertex a finite x, y and z"
    );
}

/// Plate of 10 m by 8 m, as OBJ without its faces.
const PLATE: &str = "v -5 -4 0\nv 5 -4 0\nv 5 4 0\nv -5 4 0\n";

#[test]
fn meshes_of_other_programs_have_their_area() {
    let ply = |elements: &str, rows: &str| {
        let vertices = PLATE.replace("v ", "");
        let xyz = "property float x\nproperty float y\nproperty float z";
        format!("ply\nformat ascii 1.0\nelement vertex 4\n{xyz}\nelement {elements}\nend_header\n{vertices}{rows}\n")
    };
    let faces = |count: usize| format!("face {count}\nproperty list uchar int vertex_indices");
    let cases = [
        ("degenerate.ply", ply(&faces(3), "3 0 1 2\n3 0 2 3\n3 0 0 1"), 2, 80.0),
        ("quad-corner-twice.obj", format!("{PLATE}f 1 2 2 3\nf 1 3 4 4\n"), 2, 80.0),
        (
            "concave-U.obj",
            "v 0 0 0\nv 6 0 0\nv 6 5 0\nv 4 5 0\nv 4 2 0\nv 2 2 0\nv 2 5 0\nv 0 5 0\nf 1 2 3 4 5 6 7 8\n".into(),
            6,
            24.0,
        ),
        ("continued-line.obj", format!("{PLATE}f 1 2 \\\n3 4\n"), 2, 80.0),
        ("bom.obj", format!("\u{feff}{PLATE}f 1 2 3 4\n"), 2, 80.0),
        ("cr-lines.ply", ply(&faces(2), "3 0 1 2\n3 0 2 3").replace('\n', "\r"), 2, 80.0),
        ("tristrips.ply", ply("tristrips 1\nproperty list int int vertex_indices", "5 0 1 3 2 -1"), 2, 80.0),
    ];
    for (name, text, triangles, size) in cases {
        let mesh = read_text(name, text.as_bytes()).unwrap();
        assert_eq!((mesh.triangles.len(), area(&mesh)), (triangles, size), "{name}");
        let up = mesh.all_corners().iter().all(|[a, b, c]| (b - a).cross(c - a).z > 0.0);
        assert!(up, "{name}");
    }
    let Some(folder) = shared("cases/scenes/mesh") else { return };
    for (name, triangles, size) in [
        "degenerate.ply",
        "quad-corner-twice.obj",
        "continued-line.obj",
        "bom.obj",
        "cr-lines.ply",
        "final-newline.ply",
        "tristrips.ply",
    ]
    .map(|name| (name, 2, 80.0))
    .into_iter()
    .chain([("concave-U.obj", 6, 24.0)])
    {
        let mesh = read_mesh(&folder.join(name)).unwrap();
        assert_eq!((mesh.triangles.len(), area(&mesh)), (triangles, size), "{name}");
    }
}

#[test]
fn shared_xml_files_give_their_right_answers() {
    let Some(folder) = shared("cases/scenes/xml") else { return };
    for (name, triangles, size) in [
        ("cube.xml", 14, 118.0),
        ("rectangle.xml", 4, 160.0),
        ("unused-visual-material.xml", 2, 80.0),
        ("radio-material-named-itu.xml", 2, 80.0),
    ] {
        let scene = SceneFile::read(&folder.join(name)).unwrap();
        let meshes: Vec<Mesh> = scene.objects.iter().map(|object| object.placed_mesh(false).unwrap()).collect();
        let count = meshes.iter().map(|mesh| mesh.triangles.len()).sum::<usize>();
        assert!((count, meshes.iter().map(area).sum()) == (triangles, size), "{name}");
        let glass = name.starts_with("radio-material");
        let materials = scene.objects.iter().map(|object| &*object.finish().unwrap().material);
        assert!(materials.into_iter().all(|material| material == if glass { "glass" } else { "concrete" }), "{name}");
    }
}

#[test]
fn named_meshes_are_those_of_mitsuba() {
    let [cube, plate] = ["cube", "rectangle"].map(|name| read_mesh(Path::new(name)).unwrap());
    assert!(cube.is_closed() && (volume(&cube), area(&cube), cube.triangles.len()) == (8.0, 24.0, 12));
    assert_eq!((area(&plate), plate.triangles.len()), (4.0, 2));
    assert!(plate.all_corners().iter().all(|[a, b, c]| (b - a).cross(c - a) == 4.0 * DVec3::Z));
}

#[test]
fn reference_room_is_closed() {
    let Some(folder) = shared("reference/paths/sceneA/mesh") else { return };
    let mut room = Mesh::default();
    for name in ["ceiling", "floor", "wall_xneg", "wall_xpos", "wall_yneg", "wall_ypos"] {
        let face = read_mesh(&folder.join(format!("{name}.ply"))).unwrap();
        assert_eq!((face.vertices.len(), face.triangles.len(), face.boundary_edge_count()), (4, 2, 4));
        let first = room.vertices.len() as u32;
        room.triangles.extend(face.triangles.iter().map(|t| t.map(|v| v + first)));
        room.vertices.extend(face.vertices);
    }
    let room = room.welded();
    assert!(room.is_closed());
    assert_eq!((room.vertices.len(), area(&room)), (8, 2.0 * (6.0 * 5.0 + 6.0 * 3.0 + 5.0 * 3.0)));
}

proptest! {
    /// Every validated mesh is usable.
    #[test]
    fn valid_mesh_has_triangles_of_positive_area(
        corners in prop::collection::vec(prop::array::uniform3(-2..3i32), 1..8),
        triangles in prop::collection::vec(prop::array::uniform3(0..9u32), 0..5),
    ) {
        let vertices = corners.iter().map(|c| DVec3::from_array(c.map(f64::from))).collect();
        let mesh = Mesh { vertices, triangles };
        let welded = mesh.clone().welded();
        prop_assert_eq!(mesh.check(Path::new("a")).is_ok(), welded.check(Path::new("a")).is_ok());
        if welded.check(Path::new("a")).is_ok() {
            prop_assert_eq!(mesh.all_corners(), welded.all_corners());
            prop_assert!(welded.all_corners().iter().all(|[a, b, c]| (b - a).cross(c - a).length() > 0.0));
            prop_assert!(welded.boundary_edge_count() <= 3 * welded.triangles.len());
        }
    }
}

//! The same small cloud in every encoding, and errors of broken files.

use super::*;

const BODY: &str = "comment a room\nelement camera 1\nproperty list uchar float pose\nelement vertex 2\n\
    property uchar red\nproperty double z\nproperty float x\nproperty list uchar short tags\nproperty float y\n\
    element face 1\nproperty list uchar int vertex_indices\nend_header\n";

fn header(format: &str) -> Vec<u8> {
    format!("ply\nformat {format} 1.0\n{BODY}").into_bytes()
}

fn binary(big: bool) -> Vec<u8> {
    fn put<const N: usize>(out: &mut Vec<u8>, big: bool, mut little: [u8; N]) {
        if big {
            little.reverse();
        }
        out.extend(little);
    }
    let mut out = header(if big { "binary_big_endian" } else { "binary_little_endian" });
    out.push(1);
    put(&mut out, big, 9.0f32.to_le_bytes());
    for (x, y, z) in [(1.0f32, -2.0f32, 0.5f64), (0.0, 4.0, 3.0)] {
        out.push(200);
        put(&mut out, big, z.to_le_bytes());
        put(&mut out, big, x.to_le_bytes());
        out.push(2);
        put(&mut out, big, 7i16.to_le_bytes());
        put(&mut out, big, (-7i16).to_le_bytes());
        put(&mut out, big, y.to_le_bytes());
    }
    out.push(3);
    (0..3i32).for_each(|i| put(&mut out, big, i.to_le_bytes()));
    out
}

fn ascii() -> Vec<u8> {
    let mut out = header("ascii");
    out.extend(b"1 9\n200 .5 1 2 7 -7 -2\n\n200 3 0 0 4e0\n3 0 1 2\n");
    out
}

fn read(bytes: &[u8]) -> Result<Vec<[f64; 3]>, String> {
    parse_points(Path::new("a.ply"), bytes).map_err(|e| e.to_string())
}

#[test]
fn every_ply_encoding_gives_same_points() {
    let points = vec![[1.0, -2.0, 0.5], [0.0, 4.0, 3.0]];
    assert_eq!(read(&ascii()).unwrap(), points);
    assert_eq!(read(&binary(false)).unwrap(), points);
    assert_eq!(read(&binary(true)).unwrap(), points);
    let crlf = String::from_utf8(ascii()).unwrap().replace('\n', "\r\n");
    assert_eq!(read(crlf.as_bytes()).unwrap(), points);
}

#[test]
fn rejects_header_that_takes_quadratic_time() {
    let property = |i: usize| format!("property float p{i}\n");
    let properties: String = (0..20_000).map(property).collect();
    let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n");
    let expected = "a.ply:10001:1: the header has more than 10000 lines; shorten it";
    assert_eq!(read(text.as_bytes()).unwrap_err(), expected);
}

#[test]
fn rejects_every_truncated_point_cloud() {
    for (whole, has_line_end) in [(ascii(), true), (binary(false), false), (binary(true), false)] {
        // The end of the last line may be missing, and a number that is cut short may still be one.
        for length in 0..whole.len() - 2 * usize::from(has_line_end) {
            assert!(read(&whole[..length]).is_err(), "{length} of {} bytes", whole.len());
        }
    }
    let cut = binary(true);
    assert_eq!(
        read(&cut[..cut.len() - 1]).unwrap_err(),
        "a.ply: ends after 0 of 1 rows of element `face`; the file is cut short: copy it again"
    );
}

#[test]
fn reports_invalid_input() {
    let edit = |from: &str, to: &str| String::from_utf8(ascii()).unwrap().replace(from, to);
    let cases = [
        (edit(".5 1", "nan 1"), format!("a.ply:16:5: `nan` is not finite; {POINT_ADVICE}")),
        (edit("4e0", "four"), format!("a.ply:18:11: `four` is not a number; {POINT_ADVICE}")),
        (
            edit("200 .5 1 2 7 -7 -2", "200 .5 1 2 7"),
            "a.ply:16:13: the row of element `vertex` ends early; give every property of the header".into(),
        ),
        (edit("1 2 7", "1 -2 7"), "a.ply:16:10: `-2` is not the length of a list; correct the row".into()),
        (
            edit("float x", "float u"),
            "a.ply:6:1: element `vertex` has no property `x`; export x, y and z as float or double".into(),
        ),
        (
            edit("double z", "real z"),
            format!(
                "a.ply:8:10: `real` {TYPES}",
                TYPES = "is not a type; use char, uchar, short, ushort, int, uint, int64, uint64, float or double"
            ),
        ),
        (
            edit("ascii", "text"),
            "a.ply:2:8: `text` is not a format; use ascii, binary_little_endian or binary_big_endian".into(),
        ),
        (edit("vertex 2", "vertex two"), "a.ply:6:16: `two` is not a count; write a whole number".into()),
        (
            edit("element vertex", "element point"),
            "a.ply: has no element `vertex`; export the cloud with its points".into(),
        ),
        (
            edit("end_header\n", ""),
            "a.ply:14:1: `1` is not understood in a PLY header; remove or correct the line".into(),
        ),
        (
            edit("format ascii 1.0\n", ""),
            "a.ply: has no `format` line; write `format ascii 1.0` or a binary one".into(),
        ),
        (
            "solid cube\n".into(),
            "a.ply:1:1: is not a PLY file, which begins with the line `ply`; check the file or its extension".into(),
        ),
        ("ply\n".into(), "a.ply: the header has no end_header; copy the file again".into()),
    ];
    for (text, message) in cases {
        assert_eq!(read(text.as_bytes()).unwrap_err(), message);
    }
}

#[test]
fn rejects_non_finite_binary_vertex() {
    let mut bytes = header("binary_little_endian");
    bytes.extend([0, 0]);
    bytes.extend(f64::NAN.to_le_bytes());
    bytes.extend([0; 40]);
    assert_eq!(read(&bytes).unwrap_err(), format!("a.ply: vertex 1 of 2 is not finite; {POINT_ADVICE}"));
}

#[test]
fn rejects_header_count_beyond_file_size_immediately() {
    let huge = u64::MAX;
    for format in ["ascii", "binary_big_endian"] {
        let text = format!(
            "ply\nformat {format} 1.0\nelement nothing {huge}\nelement vertex {huge}\nproperty float x\n\
             property float y\nproperty float z\nend_header\n"
        );
        let message = read(text.as_bytes()).unwrap_err();
        assert_eq!(
            message,
            format!("a.ply: ends after 0 of {huge} rows of element `vertex`; the file is cut short: copy it again")
        );
    }
}

/// A square of one face, whose row holds another list and a number too.
fn square(format: &str) -> Vec<u8> {
    let header = "element face 1\nproperty list int char flags\nproperty list uchar uint vertex_index\n\
        property short group\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\nend_header\n";
    let mut out = format!("ply\nformat {format} 1.0\n{header}").into_bytes();
    if format == "ascii" {
        out.extend(b"2 7 7 4 0 1 2 3 -5\n0 0 0.1\n1 0 0.1\n1 1 0.1\n0 1 0.1\n");
        return out;
    }
    out.extend(2i32.to_le_bytes());
    out.extend([7, 7, 4]);
    (0..4u32).for_each(|i| out.extend(i.to_le_bytes()));
    out.extend((-5i16).to_le_bytes());
    for (x, y) in [(0.0f32, 0.0f32), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
        out.extend(x.to_le_bytes());
        out.extend(y.to_le_bytes());
        out.extend(0.1f64.to_le_bytes());
    }
    out
}

#[test]
fn triangulates_faces_in_double_precision() {
    let corners = [[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [1.0, 1.0, 0.1], [0.0, 1.0, 0.1]];
    for format in ["ascii", "binary_little_endian"] {
        let (vertices, triangles) = parse_mesh(Path::new("a.ply"), &square(format)).unwrap();
        assert_eq!(vertices, corners);
        assert_eq!(triangles, [[0, 1, 2], [0, 2, 3]]);
    }
}

#[test]
fn rejects_every_truncated_mesh() {
    for format in ["ascii", "binary_little_endian"] {
        let whole = square(format);
        for length in 0..whole.len() - 3 * usize::from(format == "ascii") {
            assert!(parse_mesh(Path::new("a.ply"), &whole[..length]).is_err(), "{length} of {} bytes", whole.len());
        }
    }
}

#[test]
fn reports_invalid_faces() {
    let read = |bytes: &[u8]| parse_mesh(Path::new("a.ply"), bytes).unwrap_err().to_string();
    let edit = |from: &str, to: &str| String::from_utf8(square("ascii")).unwrap().replace(from, to).into_bytes();
    let cases = [
        (
            edit("1 2 3 -5", "1 2 4 -5"),
            "a.ply:12:1: a face names vertex 4, counted from 0, of 4; correct the index".to_owned(),
        ),
        (edit("1 2 3 -5", "1 2.5 3 -5"), "a.ply:12:13: `2.5` is not whole; correct the index of the vertex".to_owned()),
        (
            edit("1 2 3 -5", "1 two 3 -5"),
            "a.ply:12:13: `two` is not a number; correct the index of the vertex".to_owned(),
        ),
        (
            edit("4 0 1 2 3 -5", "2 0 1 -5"),
            "a.ply:12:1: a face has 2 corners; give at least three, or remove it".to_owned(),
        ),
        (
            edit("vertex_index", "strip"),
            "a.ply:3:1: element `face` has no list `vertex_indices`; export faces by their vertices".to_owned(),
        ),
        (
            edit("element face", "element cell"),
            "a.ply: has no element `face`; export a mesh, not a point cloud".to_owned(),
        ),
    ];
    for (bytes, message) in cases {
        assert_eq!(read(&bytes), message);
    }
    // The header of the cloud promises two vertices and its face names three.
    assert_eq!(
        read(&binary(true)),
        "a.ply: row 1 of `face`: a face names vertex 2, counted from 0, of 2; correct the index"
    );
}

#[test]
fn unused_numbers_are_not_parsed() {
    let whole = String::from_utf8(ascii()).unwrap();
    let points = read(whole.as_bytes()).unwrap();
    for (from, to) in [("200 3 0", "300 3 0"), ("200 3 0", "255.0 3 0"), ("7 -7", "7 -nan(ind)"), ("1 9\n", "1 nine\n")]
    {
        assert!(whole.contains(from));
        assert_eq!(read(whole.replace(from, to).as_bytes()).unwrap(), points, "{to}");
    }
}

#[test]
fn reads_dialects_of_other_programs() {
    let read = |bytes: &[u8]| parse_mesh(Path::new("a.ply"), bytes).map_err(|e| e.to_string());
    let plate = read(&square("ascii")).unwrap();
    let text = String::from_utf8(square("ascii")).unwrap();
    assert_eq!(read(text.replace('\n', "\r").as_bytes()).unwrap(), plate, "CR ends a line");
    assert_eq!(read(text.replace("uint vertex", "int64 vertex").as_bytes()).unwrap(), plate);
    for end in ["\n", "\r\n"] {
        let longer = [&square("binary_little_endian")[..], end.as_bytes()].concat();
        assert_eq!(read(&longer).unwrap(), plate, "a final line end");
    }
    let strips = text.replace("face", "tristrips").replace("4 0 1 2 3", "9 0 1 3 2 -1 0 1 2 -1");
    assert_eq!(
        read(strips.replace("uint vertex", "int vertex").as_bytes()).unwrap().1,
        [[0, 1, 3], [3, 1, 2], [0, 1, 2]]
    );
    let many = text.replace("face 1", "face 300001");
    assert_eq!(
        read(many.as_bytes()).unwrap_err(),
        "a.ply:3:1: the mesh has 300001 faces, more than 300000; simplify it"
    );
}

#[test]
fn rejects_bytes_beyond_header_counts() {
    let edit = |from: &str, to: &str| String::from_utf8(ascii()).unwrap().replacen(from, to, 1);
    let advice = "correct the row or the header";
    let twice = |kind: &str| format!("is a repeated {kind}; give each {kind} a unique name");
    let cases = [
        (
            edit("3 0 1 2\n", "3 0 1 2\n\n1 2 3\n"),
            "a.ply:21:1: a row more than the header counts; correct its counts".to_owned(),
        ),
        (
            edit("element vertex 2", "element vertex 1"),
            "a.ply:18:14: the row of element `face` ends early; give every property of the header".into(),
        ),
        (edit("element face", "element vertex"), format!("a.ply:12:9: `vertex` {}", twice("element"))),
        (edit("property float y", "property float x"), format!("a.ply:11:16: `x` {}", twice("property"))),
        (edit("comment a room", "format ascii 1.0"), "a.ply:3:1: `format` is repeated; keep one".into()),
        (
            edit("3 0 1 2", "3 0 1 2 3"),
            format!("a.ply:19:9: `3` is more than the properties of element `face`; {advice}"),
        ),
    ];
    for (text, message) in cases {
        assert_eq!(read(text.as_bytes()).unwrap_err(), message);
    }
    for big in [false, true] {
        let longer = [&binary(big)[..], &[0; 3]].concat();
        assert_eq!(read(&longer).unwrap_err(), "a.ply: 3 bytes follow the last row; correct the header's counts");
    }
    let far = edit("4e0", "4e30");
    assert!(read(far.as_bytes()).unwrap_err().starts_with("a.ply:18:11: `4e30` is beyond 1e8 m"));
}

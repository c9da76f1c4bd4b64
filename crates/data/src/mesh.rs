//! Triangle meshes: OBJ and PLY; coordinates in metres unless the reader's caller scales them.
//!
//! Read here rather than with a crate, because a mesh that is read wrongly is a wrong room. What was tried: `tobj` 4.0.5
//! panics on a texture index out of range, makes a triangle of two corners and takes a web page for an empty mesh;
//! `mesh-loader` 0.1.13 refuses an OBJ file in which only some objects have textures. Neither reports line and column of
//! every error.

mod obj;

use crate::ply;
use crate::polygons::Triangles;
use crate::text::read_bytes;
use pwrfgs_core::{Error, Result, files::MAX_NUMBERS};
use std::path::Path;

const ADVICE: &str = "check the path of the mesh";

/// Reads the surface of a mesh file; polygons are cut into triangles.
///
/// * `.obj`: `v` and `f`, with positive and negative indices; groups, normals, textures, materials, lines and points are
///   left out, and free-form surfaces are an error.
/// * `.ply`: ascii or binary of either byte order, with an element `face` and its list `vertex_indices`.
///
/// # Errors
/// Names the file, and line and column in text: truncated, not a number, not finite, an index out of range, a face of
/// fewer than three corners, a polygon that no fan of triangles fills, unknown extension. A file without faces is read.
pub fn read_mesh(path: &Path) -> Result<Triangles> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let parse = match extension.as_str() {
        "obj" => obj::parse,
        "ply" => ply::parse_mesh,
        _ => return Err(Error::input(path, "unsupported mesh format; export it as .obj or .ply")),
    };
    parse(path, &read_bytes(path, MAX_NUMBERS, ADVICE)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_file_is_read_by_its_extension() {
        let folder = tempfile::tempdir().unwrap();
        let triangle: Triangles = (vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.1, 0.0]], vec![[0, 1, 2]]);
        let files = [
            ("a.OBJ", "v 0 0 0\nv 1 0 0\nv 0 .1 0\nf 1 2 3\n"),
            (
                "a.ply",
                "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n\
                 element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 .1 0\n3 0 1 2\n",
            ),
        ];
        for (name, text) in files {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            assert_eq!(read_mesh(&path).unwrap(), triangle, "{name}");
        }
        let message = |name: &str| read_mesh(Path::new(name)).unwrap_err().to_string();
        assert_eq!(message("a.step"), "a.step: unsupported mesh format; export it as .obj or .ply");
        assert_eq!(message("no/a.obj"), "cannot read no/a.obj: no such file; check the path of the mesh");
    }

    proptest! {
        /// Every parser gives triangles over vertices it has, or an error; whatever the bytes.
        #[test]
        fn noise_never_panics(
            noise in prop::collection::vec(any::<u8>(), 0..300),
            words in "(v |f |-?[0-9]{1,20} |[0-9]/|nan |\\.|\n){0,60}",
            header in 0..2usize,
        ) {
            let ply = "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty char x\nproperty char y\n\
                       property char z\nelement face 9\nproperty list char char vertex_indices\nend_header\n";
            let head = ["", ply][header];
            for body in [&noise[..], words.as_bytes()] {
                let bytes = [head.as_bytes(), body].concat();
                for parse in [obj::parse, ply::parse_mesh] {
                    if let Ok((vertices, triangles)) = parse(Path::new("a"), &bytes) {
                        prop_assert!(triangles.iter().flatten().all(|&v| (v as usize) < vertices.len()));
                    }
                }
            }
        }
    }
}

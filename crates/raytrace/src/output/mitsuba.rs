//! Writes a scene as Mitsuba XML and PLY files, for Sionna RT.

use crate::material;
use crate::scene::{Finish, SceneFile, THICKEST};
use crate::world::{Triangle, World};
use glam::DVec3;
use pwrfgs_core::files::{NewFolder, write_atomically};
use pwrfgs_core::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{Display, Write as _};
use std::path::Path;
use std::{fs, iter};

/// Longest name of a file, characters.
const LONGEST: usize = 60;
/// Number of steps per metre of a coordinate; neighbouring triangles then have equal corners.
const STEPS: f64 = 1e9;
/// Largest conductivity, S/m, for the single precision of Sionna RT; scenes from Mitsuba files have the same limit.
const MOST_CONDUCTIVITY: f64 = 1e12;

/// Writes the surfaces of `scene` into the new folder `out`: `scene.xml`, and a PLY file per object, and for walls,
/// floor and ceiling. Returns the number of PLY files.
///
/// Materials of ITU-R P.2040 are written by name, others with their constants at the carrier. A solid becomes a sheet of
/// 10 m. Where objects touch, the order of the file gives the same precedence as in the scene.
///
/// # Errors
/// A scene with an opening, a permittivity outside 1 to 1,000,000, a mesh that cannot be read, or a folder that cannot be
/// written.
pub fn export_scene(scene: &SceneFile, out: &Path) -> Result<usize> {
    check_exportable(scene)?;
    let world = World::from_scene(scene)?;
    let new_folder = NewFolder::begin(out)?;
    let meshes = new_folder.path().join("meshes");
    fs::create_dir(&meshes).map_err(|e| Error::write(&meshes, e))?;
    let (mut ids, mut shapes) = (BTreeSet::new(), String::new());
    // Surfaces have the order of the finishes. Later layers cover earlier ones, and among sheets the first counts.
    let layer = |surface| world.faces.iter().find(|face| face.surface == surface).map(|face| face.layer);
    let mut order: Vec<_> = (0..).zip(scene.finishes()).filter(|(surface, _)| layer(*surface).is_some()).collect();
    order.sort_by_key(|(surface, _)| std::cmp::Reverse(layer(*surface)));
    for (surface, (name, finish)) in order {
        let faces = world.faces.iter().filter(|face| face.surface == surface);
        let triangles = faces.flat_map(|face| &world.triangles[face.triangles.clone()]);
        let base = plain_name(name);
        let mut candidates = iter::once(base.clone()).chain((2..).map(|k| format!("{base}-{k}")));
        let id = candidates.find(|id| ids.insert(id.to_lowercase())).expect("numbers do not end");
        let file = format!("meshes/{id}.ply");
        write_atomically(&new_folder.path().join(&file), format_ply(triangles.map(Triangle::corners)).as_bytes())?;
        let (source, flat) =
            (format_property("string", "filename", &file), format_property("boolean", "face_normals", &true));
        let bsdf = format_bsdf(scene, &id, finish);
        writeln!(shapes, "    <shape type=\"ply\" id=\"{id}\">\n{source}{flat}{bsdf}    </shape>").expect("text grows");
    }
    let head =
        format!("<!-- simulated scene {}, carrier {} Hz; by pwrfgs -->", plain_name(&scene.name), scene.carrier_hz);
    let text = format!("<scene version=\"2.1.0\">\n    {head}\n{shapes}</scene>\n");
    write_atomically(&new_folder.path().join("scene.xml"), text.as_bytes())?;
    new_folder.publish()?;
    Ok(ids.len())
}

/// Returns an error for a scene with an opening, which the format does not support, or a permittivity outside the range of
/// scenes from Mitsuba files.
fn check_exportable(scene: &SceneFile) -> Result<()> {
    if let Some(opening) = scene.objects.iter().find(|object| object.finish().is_none()) {
        let advice = "cannot be exported; remove it, or cut the hole into a mesh";
        return Err(Error::Config(format!("scene `{}`: opening `{}` {advice}", scene.name, opening.name())));
    }
    for (name, finish) in scene.finishes() {
        let permittivity =
            scene.material(&finish.material).map_or(1.0, |material| material.constants(scene.carrier_hz).0);
        if !(1.0..=1e6).contains(&permittivity) {
            let problem = format!("`{name}`: a permittivity of {permittivity} cannot be exported (1 to 1,000,000)");
            return Err(Error::Config(format!("scene `{}`: object {problem}; change its material", scene.name)));
        }
    }
    Ok(())
}

/// Returns `name` with letters, digits, single `-` and `_` only, shortened; `object` if nothing remains.
fn plain_name(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').filter(|word| !word.is_empty());
    let joined = words.collect::<Vec<_>>().join("-");
    if joined.is_empty() { "object".into() } else { joined.chars().take(LONGEST).collect() }
}

/// Formats a property element of XML as one line.
fn format_property(kind: &str, name: &str, value: &dyn Display) -> String {
    format!("        <{kind} name=\"{name}\" value=\"{value}\"/>\n")
}

/// Formats the material of the shape `id` as an element of XML.
fn format_bsdf(scene: &SceneFile, id: &str, finish: &Finish) -> String {
    let material = scene.material(&finish.material).expect("materials were looked up when the scene was read");
    let is_itu = !scene.materials.contains_key(&finish.material)
        && material.is_in_valid_range(scene.carrier_hz)
        && !material::ONLY_HERE.contains(&&*finish.material);
    let (permittivity, conductivity) = material.constants(scene.carrier_hz);
    let (kind, constants) = if is_itu {
        ("itu-radio-material", format_property("string", "type", &finish.material))
    } else {
        let conductivity = format_property("float", "conductivity", &conductivity.min(MOST_CONDUCTIVITY));
        ("radio-material", format_property("float", "relative_permittivity", &permittivity) + &conductivity)
    };
    // Waves do not reach the far side of a solid.
    let thickness = format_property("float", "thickness", &finish.thickness_m.unwrap_or(THICKEST));
    let roughness = finish.roughness.unwrap_or(scene.propagation.roughness);
    let roughness = format_property("float", "scattering_coefficient", &roughness);
    format!("        <bsdf type=\"{kind}\" id=\"material-{id}\">\n{constants}{thickness}{roughness}        </bsdf>\n")
}

/// Formats the triangles as a PLY text with shared vertices, rounded to 1 nm.
fn format_ply(triangles: impl Iterator<Item = [DVec3; 3]>) -> String {
    let (mut indices, mut vertices, mut faces, mut count) = (BTreeMap::new(), String::new(), String::new(), 0);
    for corners in triangles {
        let [a, b, c] = corners.map(|corner| {
            let steps = corner.to_array().map(|v| (v * STEPS).round() as i64);
            let next = indices.len();
            let index = *indices.entry(steps).or_insert(next);
            if index == next {
                let [x, y, z] = steps.map(|v| v as f64 / STEPS);
                writeln!(vertices, "{x} {y} {z}").expect("text grows");
            }
            index
        });
        writeln!(faces, "3 {a} {b} {c}").expect("text grows");
        count += 1;
    }
    let head = format!("ply\nformat ascii 1.0\nelement vertex {}\n", indices.len());
    let coordinates = ["x", "y", "z"].map(|axis| format!("property double {axis}\n")).concat();
    format!(
        "{head}{coordinates}element face {count}\nproperty list uchar int vertex_indices\nend_header\n{vertices}{faces}"
    )
}

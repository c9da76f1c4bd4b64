//! Converts a scene file to a world: meshes of the room and its objects.

use super::build::{WorldBuilder, WorldPart};
use super::{Surface, World};
use crate::mesh::{MOST_TRIANGLES, Mesh};
use crate::scene::{Finish, Object, Outline, Room, SceneFile};
use earcut::Earcut;
use glam::{DMat3, DVec2, DVec3};
use pwrfgs_core::{Error, Result};

impl World {
    /// Builds the geometry of `scene`.
    ///
    /// # Errors
    /// A mesh that cannot be read, or a solid mesh that is not closed; an opening outside any wall; too many triangles
    /// or contacts.
    pub fn from_scene(scene: &SceneFile) -> Result<Self> {
        let mut builder = WorldBuilder::default();
        match &scene.room {
            Some(room) => add_room(&mut builder, scene, room),
            None => builder.begin_open_scene(),
        }
        for object in &scene.objects {
            add_object(&mut builder, scene, object)?;
            if builder.triangle_count() > MOST_TRIANGLES {
                return Err(Error::Config(format!(
                    "scene `{}`: with `{}` it has {} triangles, more than {MOST_TRIANGLES}; simplify its meshes",
                    scene.name,
                    object.name(),
                    builder.triangle_count()
                )));
            }
        }
        builder.build().map_err(|why| Error::Config(format!("scene `{}`: {why}", scene.name)))
    }
}

impl SceneFile {
    /// Returns the triangles of all surfaces without `ceiling` in their names, for a view from above; corner positions
    /// in metres.
    ///
    /// # Errors
    /// Errors of [`World::from_scene`].
    pub fn surfaces_below_ceiling(&self) -> Result<Vec<[[f64; 3]; 3]>> {
        let world = World::from_scene(self)?;
        let shown =
            world.triangles.iter().filter(|triangle| !world.faces[triangle.face as usize].name.contains("ceiling"));
        Ok(shown.map(|triangle| triangle.corners().map(|corner| corner.to_array())).collect())
    }
}

/// Returns the surface properties of a finish at the carrier.
fn surface_properties(scene: &SceneFile, owner: &str, finish: &Finish) -> Surface {
    let material = scene.material(&finish.material).expect("materials were looked up when the scene was read");
    if !material.is_in_valid_range(scene.carrier_hz) {
        tracing::debug!(
            "material `{}` is extrapolated to {} GHz; the table covers {} to {} GHz",
            finish.material,
            scene.carrier_hz / 1e9,
            material.range_ghz.0,
            material.range_ghz.1
        );
    }
    Surface {
        object: owner.into(),
        eta: material.permittivity(scene.carrier_hz),
        thickness: finish.thickness_m,
        roughness: finish.roughness.unwrap_or(scene.propagation.roughness),
        lobe: scene.propagation.lobe,
    }
}

/// Adds the room as the first part, and its surfaces in the order of [`SceneFile::finishes`], which the export relies on.
fn add_room(builder: &mut WorldBuilder, scene: &SceneFile, Room { outline, walls, floor, ceiling }: &Room) {
    let [walls, floor, ceiling] = [("walls", walls), ("floor", floor), ("ceiling", ceiling)]
        .map(|(owner, f)| builder.add_surface(surface_properties(scene, owner, f)));
    let describe = |normal: DVec3, number: usize| match normal.z {
        z if z > 0.5 => ("floor".into(), floor),
        z if z < -0.5 => ("ceiling".into(), ceiling),
        _ => (format!("wall {}", number + 1), walls),
    };
    builder.add_part(&WorldPart { name: "room", mesh: &room_mesh(outline), closed: true, describe: &describe });
}

/// Returns the mesh of walls, floor and ceiling with normals inwards; the walls come first.
fn room_mesh(outline: &Outline) -> Mesh {
    let (mut plan, bottom, top) = match outline {
        Outline::Box { low: [x0, y0, z0], high: [x1, y1, z1] } => {
            (vec![[*x0, *y0], [*x1, *y0], [*x1, *y1], [*x0, *y1]], *z0, *z1)
        }
        Outline::Plan { corners, floor, ceiling } => (corners.clone(), *floor, *ceiling),
    };
    let signed_area: f64 =
        (0..plan.len()).map(|i| DVec2::from(plan[i]).perp_dot(DVec2::from(plan[(i + 1) % plan.len()]))).sum();
    if signed_area < 0.0 {
        plan.reverse();
    }
    let n = plan.len() as u32;
    let level = |z: f64| plan.iter().map(move |p| DVec3::new(p[0], p[1], z));
    let vertices: Vec<DVec3> = level(bottom).chain(level(top)).collect();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for a in 0..n {
        let b = (a + 1) % n;
        triangles.extend([[a, b + n, b], [a, a + n, b + n]]);
    }
    let mut cut: Vec<u32> = Vec::new();
    Earcut::new().earcut(plan.iter().copied(), &[], &mut cut);
    for t in cut.chunks_exact(3) {
        let [a, b, c] = [t[0], t[1], t[2]];
        let turn = |i: u32, j: u32| DVec2::from(plan[j as usize]) - DVec2::from(plan[i as usize]);
        let [b, c] = if turn(a, b).perp_dot(turn(a, c)) > 0.0 { [b, c] } else { [c, b] };
        triangles.extend([[a, b, c], [a + n, c + n, b + n]]);
    }
    Mesh { vertices, triangles }
}

/// Adds an object and its surface, or cuts an opening into earlier parts.
///
/// # Errors
/// A mesh that cannot be read or is not closed as required, or an opening outside any wall.
fn add_object(builder: &mut WorldBuilder, scene: &SceneFile, object: &Object) -> Result<()> {
    let name = object.name();
    let upright = |from: &[f64; 2], to: &[f64; 2], [low, high]: &[f64; 2]| {
        let corner = |p: &[f64; 2], z: f64| DVec3::new(p[0], p[1], z);
        [corner(from, *low), corner(to, *low), corner(to, *high), corner(from, *high)]
    };
    if let Object::Opening { from, to, heights, .. } = object {
        let cut = builder.cut_opening(&upright(from, to, heights));
        return cut.map_err(|why| Error::Config(format!("scene `{}`: opening `{name}` {why}", scene.name)));
    }
    let Some(finish) = object.finish() else { return Ok(()) };
    let solid = finish.thickness_m.is_none();
    let finish = builder.add_surface(surface_properties(scene, name, finish));
    let (mesh, closed) = match object {
        Object::Box { low, high, yaw_deg, .. } => (cuboid_mesh(DVec3::from(*low), DVec3::from(*high), *yaw_deg), true),
        Object::Panel { from, to, heights, .. } => {
            (Mesh { vertices: upright(from, to, heights).into(), triangles: vec![[0, 1, 2], [0, 2, 3]] }, false)
        }
        Object::Mesh { hollow, .. } => {
            let mesh = object.placed_mesh(solid)?;
            let closed = !hollow && mesh.is_closed();
            (mesh, closed)
        }
        Object::Opening { .. } => return Ok(()),
    };
    let describe = |normal: DVec3, number: usize| {
        let label = match object {
            Object::Box { .. } if normal.z > 0.5 => "/top".into(),
            Object::Box { .. } if normal.z < -0.5 => "/bottom".into(),
            Object::Box { .. } => format!("/side {}", number + 1),
            Object::Mesh { .. } => format!("/face {}", number + 1),
            Object::Panel { .. } | Object::Opening { .. } => String::new(),
        };
        (format!("{name}{label}"), finish)
    };
    builder.add_part(&WorldPart { name, mesh: &mesh, closed, describe: &describe });
    Ok(())
}

/// Returns the mesh of a box rotated by `yaw_deg` about its vertical axis; normals outwards, sides first.
fn cuboid_mesh(low: DVec3, high: DVec3, yaw_deg: f64) -> Mesh {
    let middle = 0.5 * (low + high);
    let turn = DMat3::from_rotation_z(yaw_deg.to_radians());
    let corner = |i: u32| {
        let pick = |bit: u32, k: usize| if i >> bit & 1 == 1 { high[k] } else { low[k] };
        // Corners 0 to 3 run counter-clockwise at the bottom, 4 to 7 above them.
        let p = DVec3::new(if matches!(i & 3, 1 | 2) { high.x } else { low.x }, pick(1, 1), pick(2, 2));
        middle + turn * (p - middle)
    };
    let vertices = (0..8).map(corner).collect();
    let quad = |[a, b, c, d]: [u32; 4]| [[a, b, c], [a, c, d]];
    let sides = [[0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7], [4, 5, 6, 7], [3, 2, 1, 0]];
    Mesh { vertices, triangles: sides.into_iter().flat_map(quad).collect() }
}

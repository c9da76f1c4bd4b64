//! Scenes with errors of material and position, as from an imperfect survey.

use crate::scene::{Object, Outline, SceneFile};
use crate::world::TOUCHING;
use glam::DVec2;
use pwrfgs_core::rng::{self, Rng};

/// Errors of a scene model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SceneErrors {
    /// Standard deviation of the logarithm of permittivities, conductivities and thicknesses: 0.2 is about 20 %.
    pub(crate) materials: f64,
    /// Standard deviation of the position of each wall and object along each horizontal axis, and of the ceiling
    /// height, metres.
    pub(crate) positions_m: f64,
    /// Random seed.
    pub(crate) seed: u64,
    /// Number of the random draw.
    pub(crate) draw: u64,
}

/// Returns the scene with errors, drawn independently per finish, and per wall and object. Objects stay on the floor;
/// receiver and transmitters keep their positions, which are usually measured best.
pub(crate) fn perturbed(scene: &SceneFile, errors: &SceneErrors) -> SceneFile {
    let mut wrong = scene.clone();
    perturb_materials(&mut wrong, errors);
    if errors.positions_m > 0.0 {
        let mut rng = rng::stream(errors.seed, "wrong places", errors.draw);
        let mut error = || errors.positions_m * rng::normal(&mut rng) as f64;
        if let Some(room) = &mut wrong.room {
            move_walls(&mut room.outline, &mut error);
        }
        wrong.objects.iter_mut().for_each(|object| move_object(object, [error(), error()]));
        move_openings(scene, &mut wrong);
    }
    wrong
}

/// Gives each finish a separate material and a thickness with random errors; does nothing at a deviation of 0.
fn perturb_materials(scene: &mut SceneFile, errors: &SceneErrors) {
    if errors.materials == 0.0 {
        return;
    }
    let truth = scene.clone();
    let mut rng = rng::stream(errors.seed, "wrong materials", errors.draw);
    let factor = |rng: &mut Rng| (errors.materials * rng::normal(rng) as f64).exp();
    let room = scene.room.iter_mut().flat_map(|room| [&mut room.walls, &mut room.floor, &mut room.ceiling]);
    for (i, finish) in room.chain(scene.objects.iter_mut().filter_map(Object::finish_mut)).enumerate() {
        let mut material = truth.material(&finish.material).expect("materials were looked up when the scene was read");
        material.a = (material.a * factor(&mut rng)).max(1.0); // at least that of vacuum
        material.c *= factor(&mut rng);
        finish.thickness_m = finish.thickness_m.map(|t| t * factor(&mut rng));
        finish.material = format!("{} {i}", finish.material);
        scene.materials.insert(finish.material.clone(), material);
    }
}

/// Moves each wall of a box or corner of a plan, and the ceiling. `error` draws the next error of a coordinate, metres.
fn move_walls(outline: &mut Outline, error: &mut dyn FnMut() -> f64) {
    match outline {
        Outline::Box { low, high } => {
            for k in 0..2 {
                low[k] += error();
                high[k] += error();
            }
            high[2] += error();
        }
        Outline::Plan { corners, ceiling, .. } => {
            corners.as_flattened_mut().iter_mut().for_each(|v| *v += error());
            *ceiling += error();
        }
    }
}

/// Moves an object horizontally by `by`, metres along x and y.
fn move_object(object: &mut Object, by: [f64; 2]) {
    let (first, second): (&mut [f64], Option<&mut [f64]>) = match object {
        Object::Box { low, high, .. } => (low, Some(high)),
        Object::Panel { from, to, .. } | Object::Opening { from, to, .. } => (from, Some(to)),
        Object::Mesh { shift, .. } => (shift, None),
    };
    for corner in [Some(first), second].into_iter().flatten() {
        corner.iter_mut().zip(by).for_each(|(v, error)| *v += error);
    }
}

/// Moves each opening together with its host, the last side before it that it lies on: its corners keep their relative
/// positions along the host, and its upper edge stays below the moved ceiling. An opening without a host stays.
fn move_openings(truth: &SceneFile, wrong: &mut SceneFile) {
    let top = |scene: &SceneFile| match scene.room.as_ref().map(|room| &room.outline) {
        Some(Outline::Box { high, .. }) => high[2],
        Some(Outline::Plan { ceiling, .. }) => *ceiling,
        None => f64::INFINITY,
    };
    for k in 0..truth.objects.len() {
        let Object::Opening { from, to, heights, .. } = &truth.objects[k] else { continue };
        let (old, new) = (upright_sides(truth, k), upright_sides(wrong, k));
        let shares = |side: &[DVec2; 2]| Some([position_along(side, *from)?, position_along(side, *to)?]);
        let host = old.iter().enumerate().rev().find_map(|(i, side)| Some((new[i], shares(side)?)));
        let Some(([a, b], shares)) = host else { continue };
        let corners = shares.map(|t| a.lerp(b, t).to_array());
        let upper = if heights[1] <= top(truth) { heights[1].min(top(wrong)) } else { heights[1] };
        if let Object::Opening { from, to, heights, .. } = &mut wrong.objects[k] {
            [*from, *to] = corners;
            heights[1] = upper;
        }
    }
}

/// Returns the upright sides of the room and of the first `count` objects as seen from above: end points in metres, in an
/// order that does not depend on positions.
fn upright_sides(scene: &SceneFile, count: usize) -> Vec<[DVec2; 2]> {
    let ring = |corners: &[DVec2]| -> Vec<[DVec2; 2]> {
        (0..corners.len()).map(|i| [corners[i], corners[(i + 1) % corners.len()]]).collect()
    };
    let rectangle = |low: &[f64; 3], high: &[f64; 3], yaw_deg: f64| {
        let corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]].map(DVec2::from);
        let middle = 0.5 * (corners[0] + corners[2]);
        ring(&corners.map(|p| middle + DVec2::from_angle(yaw_deg.to_radians()).rotate(p - middle)))
    };
    let mut sides = match scene.room.as_ref().map(|room| &room.outline) {
        Some(Outline::Box { low, high }) => rectangle(low, high, 0.0),
        Some(Outline::Plan { corners, .. }) => ring(&corners.iter().copied().map(DVec2::from).collect::<Vec<_>>()),
        None => Vec::new(),
    };
    for object in &scene.objects[..count] {
        match object {
            Object::Box { low, high, yaw_deg, .. } => sides.extend(rectangle(low, high, *yaw_deg)),
            Object::Panel { from, to, .. } => sides.push([DVec2::from(*from), DVec2::from(*to)]),
            Object::Opening { .. } | Object::Mesh { .. } => {}
        }
    }
    sides
}

/// Returns the relative position of a point along a side, from 0 to 1; `None` if it is not on the side.
fn position_along([a, b]: &[DVec2; 2], point: [f64; 2]) -> Option<f64> {
    let (along, to) = (*b - *a, DVec2::from(point) - *a);
    let t = to.dot(along) / along.length_squared();
    let reach = TOUCHING / along.length();
    let is_on = (along.perp_dot(to) / along.length()).abs() < TOUCHING && t > -reach && t < 1.0 + reach;
    is_on.then_some(t.clamp(0.0, 1.0))
}

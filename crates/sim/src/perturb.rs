//! A scene as somebody would know it who measured it with errors.

use crate::scene::{Object, Outline, Scene};
use pwrfgs_core::rng::{self, Rng};

/// How wrong a scene is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Errors {
    /// Standard deviation of the logarithm of permittivities, conductivities and thicknesses: 0.2 is about 20 %.
    pub(crate) materials: f64,
    /// Standard deviation of the place of each wall and object along each horizontal axis, and of the ceiling's height,
    /// metres.
    pub(crate) positions_m: f64,
    /// Which errors.
    pub(crate) seed: u64,
    /// Which draw of them.
    pub(crate) draw: u64,
}

/// The scene with errors. Every finish has errors of its own. Objects stay on the floor, and the receiver and the
/// transmitters stay where they are: they are what was measured best.
pub(crate) fn perturbed(scene: &Scene, errors: &Errors) -> Scene {
    let mut wrong = scene.clone();
    finishes(&mut wrong, errors);
    if errors.positions_m > 0.0 {
        let mut rng = rng::stream(errors.seed, "wrong places", errors.draw);
        let mut error = || errors.positions_m * rng::normal(&mut rng) as f64;
        move_walls(&mut wrong.room.outline, &mut error);
        wrong.objects.iter_mut().for_each(|object| move_object(object, [error(), error()]));
    }
    wrong
}

/// Gives each finish a material of its own, some way off the true one.
fn finishes(scene: &mut Scene, errors: &Errors) {
    if errors.materials == 0.0 {
        return;
    }
    let truth = scene.clone();
    let mut rng = rng::stream(errors.seed, "wrong materials", errors.draw);
    let factor = |rng: &mut Rng| (errors.materials * rng::normal(rng) as f64).exp();
    let room = &mut scene.room;
    let all = [&mut room.walls, &mut room.floor, &mut room.ceiling].into_iter();
    for (i, finish) in all.chain(scene.objects.iter_mut().map(Object::finish_mut)).enumerate() {
        let mut material = truth.material(&finish.material).expect("materials were looked up when the scene was read");
        material.a = (material.a * factor(&mut rng)).max(1.0);
        material.c *= factor(&mut rng);
        finish.thickness_m = finish.thickness_m.map(|t| t * factor(&mut rng));
        finish.material = format!("{} {i}", finish.material);
        scene.materials.insert(finish.material.clone(), material);
    }
}

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

fn move_object(object: &mut Object, by: [f64; 2]) {
    let (first, second): (&mut [f64], Option<&mut [f64]>) = match object {
        Object::Box { low, high, .. } => (low, Some(high)),
        Object::Panel { from, to, .. } => (from, Some(to)),
        Object::Mesh { shift, .. } => (shift, None),
    };
    for place in [Some(first), second].into_iter().flatten() {
        place.iter_mut().zip(by).for_each(|(v, error)| *v += error);
    }
}

//! Grid of positions over the floor of a scene.

use glam::DVec3;
use pwrfgs_core::{Error, Result};
use pwrfgs_raytrace::SceneFile;
use pwrfgs_raytrace::world::{Triangle, World, from_scene};

/// Largest number of grid points, free or not.
const MOST: f64 = 1e6;

/// Positions on a grid of `step` metres at `height` (metres) over the floor of `scene`, half a step from its bounds and outside
/// its objects. Every second row is reversed, so that the grid is a walk.
///
/// # Errors
/// A step or height out of range, a scene that cannot be built, or no free position.
pub fn floor_grid(scene: &SceneFile, step: f64, height: f64) -> Result<Vec<[f64; 3]>> {
    let refuse = |what: String| Error::Config(format!("scene `{}`: {what}", scene.name));
    if !(step.is_finite() && step > 0.0) {
        return Err(refuse(format!("a grid step of {step} m, expected more than 0, such as 0.25")));
    }
    let world = from_scene(scene)?;
    let (low, high) = bounds(&world);
    if !(low.z..=high.z).contains(&height) {
        return Err(refuse(format!("a height of {height} m is outside {} to {} m; give one inside", low.z, high.z)));
    }
    let [columns, rows] = [high.x - low.x, high.y - low.y].map(|extent| (extent / step).round().max(1.0));
    if columns * rows > MOST {
        return Err(refuse(format!(
            "a grid of {columns:.0} x {rows:.0} positions, expected at most 1,000,000; give a larger step"
        )));
    }
    let at = |row: usize, column: usize| {
        let turned = if row.is_multiple_of(2) { column } else { columns as usize - 1 - column };
        let part = |low: f64, high: f64, k: usize, count: f64| low + (high - low) * (k as f64 + 0.5) / count;
        DVec3::new(part(low.x, high.x, turned, columns), part(low.y, high.y, row, rows), height)
    };
    let grid = (0..rows as usize).flat_map(|row| (0..columns as usize).map(move |column| (row, column)));
    let free: Vec<[f64; 3]> = grid
        .map(|(row, column)| at(row, column))
        .filter(|place| world.check_free(*place).is_ok())
        .map(Into::into)
        .collect();
    if free.is_empty() {
        return Err(refuse(format!(
            "no free position at a height of {height} m; give another height or a smaller step"
        )));
    }
    Ok(free)
}

/// Smallest and largest corner of all surfaces.
fn bounds(world: &World) -> (DVec3, DVec3) {
    let corners = world.triangles.iter().flat_map(Triangle::corners);
    corners.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), corner| (low.min(corner), high.max(corner)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn grid_covers_office_without_objects_as_a_walk() {
        let office = SceneFile::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/office.ron")).unwrap();
        let grid = floor_grid(&office, 0.5, 1.0).unwrap();
        assert!((170..192).contains(&grid.len()), "{}", grid.len());
        assert_eq!((grid[0], grid[1]), ([0.25, 0.25, 1.0], [0.75, 0.25, 1.0]));
        let is_in_copier = |[x, y, _]: &[f64; 3]| (7.2..7.9).contains(x) && (2.4..3.1).contains(y);
        assert!(!grid.iter().any(is_in_copier));
        assert!(floor_grid(&office, 0.0, 1.0).is_err() && floor_grid(&office, 1e-4, 1.0).is_err());
        let message = floor_grid(&office, 0.5, 9.0).unwrap_err().to_string();
        assert!(message.contains("outside") && message.contains("give one inside"), "{message}");
    }
}

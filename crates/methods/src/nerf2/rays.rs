//! `Rays`: from where, in which directions, and where along them samples lie.

use crate::nerf2::method::Nerf2;
use pwrfgs_core::{Frame, Pixels, Real};

/// Rays from one place, with the same samples on each.
#[derive(Clone, Debug)]
pub(crate) struct Rays {
    /// Where all begin, in the network's unit of length.
    pub(crate) origin: [Real; 3],
    /// Unit vectors away from there, in the room.
    pub(crate) directions: Vec<[Real; 3]>,
    /// Distances of the samples `[n]`, in the network's unit.
    pub(crate) samples: Vec<Real>,
}

impl Rays {
    /// Those of receiver `receiver`, as far as `pixels` are wanted of a spectrum.
    pub(crate) fn of(method: &Nerf2, frame: &Frame, receiver: usize, pixels: &Pixels<'_>) -> Self {
        let pose = &frame.receivers[receiver].pose;
        let turned = |direction: [Real; 3]| pose.turned(direction.map(f64::from)).map(|x| x as Real);
        let directions = if frame.task.has_pixels {
            let plane = &frame.plane;
            let at = |p: usize| {
                let (column, row) = (p % plane.width, p / plane.width);
                turned(plane.direction(column as Real, row as Real).unwrap_or([0.0, 0.0, 1.0]))
            };
            match pixels {
                Pixels::All => (0..frame.numbers()).map(at).collect(),
                Pixels::Same(places) | Pixels::Own(places) => places.iter().map(|&p| at(p)).collect(),
            }
        } else {
            method.sky().into_iter().map(turned).collect()
        };
        let origin = pose.position.map(|x| x as Real / method.unit_m);
        let (far, last) = (method.far_m / method.unit_m, (method.samples - 1) as Real);
        Self { origin, directions, samples: (0..method.samples).map(|i| far * i as Real / last).collect() }
    }

    /// Samples of a ray.
    pub(crate) fn samples(&self) -> usize {
        self.samples.len()
    }

    /// Where the samples of some rays are, ray by ray.
    pub(crate) fn points(&self, rays: std::ops::Range<usize>) -> Vec<[Real; 3]> {
        let along = |d: &[Real; 3]| {
            let (origin, d) = (self.origin, *d);
            self.samples.iter().map(move |t| std::array::from_fn(|k| origin[k] + t * d[k]))
        };
        self.directions[rays].iter().flat_map(along).collect()
    }
}

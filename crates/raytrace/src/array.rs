//! Antenna array of the receiver: element pattern and channel at every element.

#[cfg(test)]
mod tests;

use crate::Complex;
use crate::path::PropagationPath;
use glam::DVec3;
use pwrfgs_core::ArrayGeometry;
use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Antenna array of a receiver, whose boresight is z: a grid in its x-y plane, or `positions_wavelengths`.
///
/// Element `row * columns + column` of a grid has x from its column and y from its row, both centred: x varies fastest, as
/// in the measured files.
///
/// At a spacing of exactly half a wavelength, two opposite waves along the x or y axis of the array (on its horizon)
/// cannot be distinguished. A slightly smaller spacing, such as 0.49, resolves this.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Array {
    /// Elements along y; default 4.
    pub rows: usize,
    /// Elements along x; default 4.
    pub columns: usize,
    /// Distance between neighbours in wavelengths; default 0.5.
    pub spacing_wavelengths: f64,
    /// Element positions `[K]` in place of the grid, for example of a circle: x, y, z from the position of the receiver, in
    /// its axes; wavelengths. Grids do not write it out, so that data of old scenes keep their key.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub positions_wavelengths: Vec<[f64; 3]>,
    /// Pattern of each element; default isotropic.
    pub element: Element,
    /// Polarisation axis in the receiver frame, of any length; default y, see [`Element::response`].
    pub polarization: [f64; 3],
    /// Model of the element phases; default `Spherical`.
    pub wavefront: ArrayWavefront,
}

/// Model of the phase at each element, given a path to the centre of the array.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum ArrayWavefront {
    /// Sources at infinite distance: exp(+j2π/λ rel·u) with u towards the source, as in the steering vector.
    Plane,
    /// Exact path length to each element, from the image of the transmitter, the edge or the patch. Amplitude and
    /// interactions are those at the centre.
    #[default]
    Spherical,
    /// Separate ray tracing for each element; cost grows with the number of elements. Amplitudes, angles at walls and
    /// shadows are then also exact.
    Traced,
}

impl Default for Array {
    fn default() -> Self {
        Self {
            rows: 4,
            columns: 4,
            spacing_wavelengths: 0.5,
            positions_wavelengths: Vec::new(),
            element: Element::Isotropic,
            polarization: [0.0, 1.0, 0.0],
            wavefront: ArrayWavefront::Spherical,
        }
    }
}

impl Check for Array {
    fn check(&self) -> Result<(), String> {
        self.geometry().check(Self::default().geometry()).map_err(|why| format!("array: {why}"))?;
        if DVec3::from(self.polarization).try_normalize().is_none() {
            let axis = self.polarization;
            return Err(format!("array: `polarization` is {axis:?}; give an axis such as (0, 1, 0)"));
        }
        self.element.check().map_err(|why| format!("array: {why}"))
    }
}

impl Array {
    /// Returns the number of elements K.
    pub fn element_count(&self) -> usize {
        self.geometry().element_count()
    }

    /// Returns the positions of the elements `[K]` relative to the receiver at a `wavelength` in metres: receiver frame,
    /// metres.
    pub fn offsets(&self, wavelength: f64) -> Vec<DVec3> {
        self.geometry().element_positions(wavelength).into_iter().map(DVec3::from).collect()
    }

    /// Returns the geometry of the elements, in wavelengths.
    fn geometry(&self) -> ArrayGeometry<'_, f64> {
        let Self { rows, columns, spacing_wavelengths: spacing, positions_wavelengths: positions, .. } = self;
        ArrayGeometry { rows: *rows, columns: *columns, spacing: *spacing, positions }
    }
}

/// Returns the channel h `[elements, wavelengths]`: the sum over paths, eq. (1) of the paper, at each element.
///
/// The paths lead to `centre`, the receiver position; `elements` are the element positions in the world. All are in
/// metres. Each wavelength has a separate wavenumber, so delays are exact; gains are common to all and include both antenna
/// patterns. [`ArrayWavefront::Traced`] needs separate paths per element, which the simulator provides; here it is
/// treated as `Spherical`.
pub fn array_channel(
    paths: &[PropagationPath],
    elements: &[DVec3],
    centre: DVec3,
    wavelengths: &[f64],
    wavefront: ArrayWavefront,
) -> Vec<Complex> {
    let wavenumbers: Vec<f64> = wavelengths.iter().map(|wavelength| TAU / wavelength).collect();
    let length = |path: &PropagationPath, element: DVec3| match wavefront {
        ArrayWavefront::Plane => path.length - (element - centre).dot(path.arrival),
        ArrayWavefront::Spherical | ArrayWavefront::Traced => path.length_to(element),
    };
    let mut channel = vec![Complex::ZERO; elements.len() * wavelengths.len()];
    for (element, row) in elements.iter().zip(channel.chunks_mut(wavelengths.len().max(1))) {
        for path in paths {
            let length = length(path, *element);
            let received = |wavenumber: &f64| path.gain * Complex::cis(-wavenumber * length);
            row.iter_mut().zip(&wavenumbers).for_each(|(h, wavenumber)| *h += received(wavenumber));
        }
    }
    channel
}

/// Antenna pattern relative to its strongest direction. No directivity is added: |gain|² of the line of sight between
/// two antennas that face each other is the Friis value for isotropic antennas.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub enum Element {
    /// Equal in all directions.
    #[default]
    Isotropic,
    /// Short dipole along the polarisation axis: |sin| of the angle from the axis, in amplitude.
    Dipole,
    /// Patch antenna: cosᵠ of the angle from boresight (z) in amplitude, zero behind.
    Patch {
        /// The exponent q; 1 is usual, 0 a half-space.
        exponent: f64,
    },
}

impl Element {
    /// Returns an error for an exponent of `Patch` outside 0 to 100: the problem and the next step.
    pub fn check(&self) -> Result<(), String> {
        match self {
            Self::Patch { exponent } if !(0.0..=100.0).contains(exponent) => {
                Err(format!("`exponent` of Patch is {exponent}; give 0 to 100, usually 1"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the amplitude of the antenna towards `direction`, and the unit vector of its electric field there.
    ///
    /// `axis` is its polarisation axis ê and `direction` is r, away from the antenna, both unit vectors in the antenna
    /// frame. The field points along -(ê - (ê·r)r), normalised: for ê = z that is θ̂ of spherical coordinates, down the
    /// meridian. If r is parallel to the axis, it is an arbitrary vector perpendicular to r.
    pub fn response(&self, axis: DVec3, direction: DVec3) -> (f64, DVec3) {
        let across = axis.cross(direction);
        let amplitude = match self {
            Self::Isotropic => 1.0,
            Self::Dipole => across.length(),
            Self::Patch { .. } if direction.z <= 0.0 => 0.0,
            Self::Patch { exponent } => direction.z.powf(*exponent),
        };
        // (ê×r)×r = -(ê - (ê·r)r), perpendicular to r even if ê and r are nearly parallel.
        let field = across.try_normalize().unwrap_or_else(|| direction.any_orthonormal_vector()).cross(direction);
        (amplitude, field)
    }
}

/// Returns the mean of |h|² over antennas and subcarriers; 0 for an empty channel.
pub(crate) fn mean_power(channel: &[Complex]) -> f64 {
    channel.iter().map(Complex::norm_sqr).sum::<f64>() / channel.len().max(1) as f64
}

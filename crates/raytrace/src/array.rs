//! The antenna array at the receiver, and its channel: what every element receives.

mod element;
#[cfg(test)]
mod tests;

use crate::path::Path;
use crate::wave::Complex;
pub use element::{Element, response};
use glam::{DMat3, DVec3};
use pwrfgs_core::plugin::Check;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Most rows, and most columns.
const LARGEST: usize = 32;

/// A uniform planar array. Its elements lie in the x-y plane of the receiver frame, z is boresight.
///
/// Element `row * columns + column` stands at x from its column, y from its row, both centred: x runs fastest. That is
/// the order of the measured files.
///
/// Spacing: at exactly half a wavelength a wave along the x or y axis of the array, on its horizon, cannot be told from
/// one out of the opposite direction. A little less, such as 0.49, has no such pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Array {
    /// Elements along y; default 4.
    pub rows: usize,
    /// Elements along x; default 4.
    pub columns: usize,
    /// Distance between neighbours in wavelengths; default 0.5.
    pub spacing_wavelengths: f64,
    /// Pattern of each element; default isotropic.
    pub element: Element,
    /// Axis of the polarisation in the receiver frame, of any length; default y, see [`response`].
    pub polarization: [f64; 3],
    /// How an element's phase follows from a path; default `Spherical`.
    pub wavefront: Wavefront,
}

/// How the phase at an element follows from a path to the centre of the array.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wavefront {
    /// As if every source were infinitely far away: exp(+j2π/λ rel·u) with u towards the wave that comes in. What the
    /// steering vector assumes.
    Plane,
    /// The exact length of the path to the element, from the transmitter's image, the edge or the patch. Amplitude and
    /// interactions are those at the centre.
    #[default]
    Spherical,
    /// Everything traced anew to every element: as many times the work as there are elements. Amplitudes, angles at
    /// walls and shadows are then exact as well.
    Traced,
}

impl Default for Array {
    fn default() -> Self {
        Self {
            rows: 4,
            columns: 4,
            spacing_wavelengths: 0.5,
            element: Element::Isotropic,
            polarization: [0.0, 1.0, 0.0],
            wavefront: Wavefront::Spherical,
        }
    }
}

impl Check for Array {
    fn check(&self) -> Result<(), String> {
        for (field, count) in [("rows", self.rows), ("columns", self.columns)] {
            if !(1..=LARGEST).contains(&count) {
                return Err(format!("array: `{field}` is {count}; give 1 to {LARGEST} antennas"));
            }
        }
        let spacing = self.spacing_wavelengths;
        if !(1e-3..=100.0).contains(&spacing) {
            return Err(format!("array: `spacing_wavelengths` is {spacing}; give 0.001 to 100, usually 0.5"));
        }
        if DVec3::from(self.polarization).try_normalize().is_none() {
            let axis = self.polarization;
            return Err(format!("array: `polarization` is {axis:?}; give an axis such as (0, 1, 0)"));
        }
        self.element.check().map_err(|why| format!("array: {why}"))
    }
}

impl Array {
    /// Number of elements K.
    pub fn elements(&self) -> usize {
        self.rows * self.columns
    }

    /// Positions of the elements `[K]` relative to the centre of the array: receiver frame, metres. `wavelength` in
    /// metres.
    pub fn offsets(&self, wavelength: f64) -> Vec<DVec3> {
        let spacing = self.spacing_wavelengths * wavelength;
        let place = |index: usize, count: usize| (index as f64 - (count as f64 - 1.0) / 2.0) * spacing;
        (0..self.elements())
            .map(|k| DVec3::new(place(k % self.columns, self.columns), place(k / self.columns, self.rows), 0.0))
            .collect()
    }

    /// The channel h `[K]`: the sum over paths, eq. (1), at each element.
    ///
    /// `center` is the receiver's position, metres; the columns of `world_from_receiver` are its axes in the world. The
    /// paths lead to `center`; their gains hold the patterns of both antennas already. [`Wavefront::Traced`] needs other
    /// paths for each element and counts as `Spherical` here; the simulator sees to it.
    pub fn channel(&self, paths: &[Path], center: DVec3, world_from_receiver: DMat3, wavelength: f64) -> Vec<Complex> {
        let elements: Vec<DVec3> =
            self.offsets(wavelength).iter().map(|offset| center + world_from_receiver * *offset).collect();
        channel_at(paths, &elements, center, wavelength, self.wavefront)
    }
}

/// The channel at antennas anywhere near `center`: `elements` and `center` in the world, metres. See [`Array::channel`].
pub fn channel_at(
    paths: &[Path],
    elements: &[DVec3],
    center: DVec3,
    wavelength: f64,
    wavefront: Wavefront,
) -> Vec<Complex> {
    band_at(paths, elements, center, &[wavelength], wavefront)
}

/// The channel `[elements, wavelengths]` at antennas anywhere near `center`, all in metres. Each wavelength has its own
/// wavenumber, so that delays are exact; gains are the same for all. See [`channel_at`].
pub fn band_at(
    paths: &[Path],
    elements: &[DVec3],
    center: DVec3,
    wavelengths: &[f64],
    wavefront: Wavefront,
) -> Vec<Complex> {
    let wavenumbers: Vec<f64> = wavelengths.iter().map(|wavelength| TAU / wavelength).collect();
    let length = |path: &Path, element: DVec3| match wavefront {
        Wavefront::Plane => path.length - (element - center).dot(path.arrival),
        Wavefront::Spherical | Wavefront::Traced => path.length_to(element),
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

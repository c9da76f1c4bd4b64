//! `ArrayResponse`: Gaussians as virtual transmitters, eq. (1), received by an antenna array, eq. (2).

mod beams;
mod wave;

use beams::Beams;
use pwrfgs_core::{
    ArrayGeometry, Cache, ImagePlane, JsonSchema, Misfit, Rasterizer, Real, Render, RenderVjp, SignalSplats, Splats,
    Vec3, cached,
};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::{Arc, PoisonError, RwLock};
use wave::Antennas;
pub use wave::Wavefront;

/// Field of all Gaussians on an antenna array, and the spatial spectrum that the array computes from it.
///
/// Each splat is a wave from its direction u. Its complex signal s has two channels, and its opacity o is the
/// amplitude. The waves add up at the antennas, h = Σ o·s·a(u) with aₖ(u) = exp(+j2π pₖ·u) and pₖ in wavelengths, eq.
/// (1). Each pixel steers the array to its direction: aᴴh/K, eq. (2) before the square. The method has no tiles, no
/// depth order and no occlusion; the cost is O(N·K + H·W·K). The measured spectra are such spectra with K = 16
/// antennas, up to the rounding of their 8 bits. Sixteen Gaussians in different directions can therefore represent each
/// of them.
///
/// *Widened*: the waves of a wide Gaussian, in equal phase, average to aₖ·exp(-(2π)² pₖᵀ Σᵤ pₖ / 2). Σᵤ is the
/// first-order covariance of u along x and y. Wide Gaussians are received mainly by the central antennas. The
/// expression is finite at the zenith, where the azimuth of the spectrum is not. The filter of the projector (a
/// fraction of a degree) counts as width.
///
/// *Spherical*: the phase follows from the distance between the Gaussian and each antenna; amplitude and width are
/// those of a plane wave. The spectra then depend on distances, which receive gradients.
///
/// *Geometry*: a grid of `rows` × `columns` antennas, or any `positions_wavelengths`, such as a circle.
///
/// *Requires* a projector whose pixels are directions (`Mercator`), signals with two channels (`readout: MinMax`,
/// `Magnitude` or `Power`) and `calibration: Physical`. *Differentiable* in means, conics, depths, opacities and
/// signals. *Discontinuous* if a Gaussian leaves the field of view of the projector. A flat array cannot distinguish u
/// from its mirror image below the horizon. Densification uses the gradient along the direction, in pixels; without a
/// depth order there is rarely a reason to densify.
///
/// Source: eq. (1) and (2) of the paper. The paper, WRF-GS and WRF-GS+ use alpha blending instead.
///
/// ```
/// use pwrfgs_core::{Plugin, Rasterizer};
/// # use pwrfgs_raster as _;
/// Plugin::<dyn Rasterizer>::parse("ArrayResponse(rows: 4, columns: 4, spacing_wavelengths: 0.491)").unwrap();
/// Plugin::<dyn Rasterizer>::parse("ArrayResponse(widened: false, wavefront: Spherical(wavelength_m: 0.326))").unwrap();
/// Plugin::<dyn Rasterizer>::parse("ArrayResponse(positions_wavelengths: [(0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)])").unwrap();
/// ```
#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ArrayResponse {
    /// Number of antennas along y of the receiver.
    pub rows: usize,
    /// Number of antennas along x of the receiver.
    pub columns: usize,
    /// Antenna spacing, wavelengths; 0.491 as measured (0.16 m at 920 MHz).
    pub spacing_wavelengths: Real,
    /// Antenna positions `[K]` in place of the grid: x, y, z from the receiver position, receiver axes; wavelengths.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub positions_wavelengths: Vec<[Real; 3]>,
    /// Whether Gaussians have the width of their covariance (`true`) or are points (`false`).
    pub widened: bool,
    /// Wavefront at the antennas: plane or spherical.
    pub wavefront: Wavefront,
}

/// Cache of the beams for the last few arrays and image planes, shared by all threads. Beams depend on the geometry
/// only, computing them takes longer than a spectrum, and models of one ensemble share them. Results do not depend on
/// the cache. Training with a moving stride needs one table per offset; together these are as large as that of the
/// whole image.
static TABLES: RwLock<Vec<CachedTable>> = RwLock::new(Vec::new());

/// Number of cached tables of whole images. With a stride, stride² times as many of the newest size: rows are padded to whole
/// blocks.
const KEPT: usize = 4;

/// Array and its table.
type CachedTable = (TableKey, Arc<Beams>);

/// Antenna positions `[K]`, wavelengths, and the image plane.
type TableKey = (Vec<Vec3>, ImagePlane);

impl Default for ArrayResponse {
    fn default() -> Self {
        Self {
            rows: 4,
            columns: 4,
            spacing_wavelengths: 0.491,
            positions_wavelengths: Vec::new(),
            widened: true,
            wavefront: Wavefront::Plane,
        }
    }
}

#[typetag::serde]
impl Rasterizer for ArrayResponse {
    fn forward(&self, splats: SignalSplats<'_>) -> Render {
        self.forward_prepared(splats, &self.prepare(splats.geometry, splats.plane))
    }

    fn prepare(&self, splats: &Splats, plane: &ImagePlane) -> Cache {
        let antennas = self.antennas(plane);
        Some(Arc::new(Steered { waves: antennas.waves(splats), beams: cached_beams(&antennas, plane) }))
    }

    fn forward_prepared(&self, splats: SignalSplats<'_>, prepared: &Cache) -> Render {
        let SignalSplats { geometry, signals, channels, plane } = splats;
        assert_eq!(signals.len(), geometry.len() * channels, "one signal per splat and channel");
        let Steered { waves, beams } = cached(prepared);
        let field = array_field(geometry, signals, waves, self.geometry().element_count(), channels);
        let mut pixels = vec![0.0; channels * plane.width * plane.height];
        beams.draw(&field, &mut pixels);
        Render { pixels, transmittance: Vec::new(), cache: prepared.clone() }
    }

    fn backward(&self, splats: SignalSplats<'_>, render: &Render, d_pixels: &[Real]) -> RenderVjp {
        let SignalSplats { geometry: splats, signals, channels, plane } = splats;
        let antennas = self.antennas(plane);
        let elements = antennas.len();
        let Steered { waves, beams } = cached(&render.cache);
        let d_field = beams.draw_vjp(d_pixels);
        let mut out = RenderVjp {
            splats: Splats::zeros(splats.len()),
            signals: vec![0.0; signals.len()],
            weights: vec![0.0; splats.len()],
        };
        let d = &mut out.splats;
        let rows = (d.means2d.par_iter_mut())
            .zip(d.conics.par_iter_mut())
            .zip(d.depths.par_iter_mut())
            .zip(d.opacities.par_iter_mut())
            .zip(out.signals.par_chunks_exact_mut(channels))
            .zip(out.weights.par_iter_mut());
        rows.enumerate().with_min_len(16).for_each(|(i, (((((mean, conic), depth), opacity), d_signals), weight))| {
            if splats.radii[i] == 0.0 {
                return;
            }
            let signal = &signals[i * channels..(i + 1) * channels];
            let wave = &waves[i * elements..(i + 1) * elements];
            let mut d_wave = vec![[0.0; 2]; elements];
            *opacity = array_field_vjp(splats.opacities[i], signal, wave, &d_field, d_signals, &mut d_wave);
            (*mean, *conic, *depth) = antennas.wave_vjp(splats, i, wave, &d_wave);
            let strength: Real = wave.iter().map(|[re, im]| re.hypot(*im)).sum();
            // In place of the sum of blending weights: opacity times mean amplitude, for every pixel.
            *weight = splats.opacities[i] * strength / elements as Real * (plane.width * plane.height) as Real;
        });
        out
    }

    fn is_coherent(&self) -> bool {
        true
    }

    fn check_plane(&self, plane: &ImagePlane) -> Result<(), Misfit> {
        if plane.angles.is_some() { Ok(()) } else { Err(Misfit::PixelsWithoutDirection) }
    }

    fn supports_carriers(&self) -> bool {
        matches!(self.wavefront, Wavefront::Plane)
    }

    fn check(&self) -> Result<(), String> {
        self.geometry().check(Self::default().geometry())?;
        match self.wavefront {
            Wavefront::Spherical { wavelength_m } if !(1e-6..=1e6).contains(&wavelength_m) => {
                Err(format!("`wavelength_m` is {wavelength_m}; give metres, such as 0.326 for 920 MHz"))
            }
            _ => Ok(()),
        }
    }
}

impl ArrayResponse {
    /// Creates the antennas for a plane whose pixels are directions.
    fn antennas(&self, plane: &ImagePlane) -> Antennas {
        Antennas::new(&self.geometry(), self.widened, self.wavefront, plane)
    }

    /// Returns the geometry of the antennas.
    fn geometry(&self) -> ArrayGeometry<'_, Real> {
        let Self { rows, columns, spacing_wavelengths: spacing, positions_wavelengths: positions, .. } = self;
        ArrayGeometry { rows: *rows, columns: *columns, spacing: *spacing, positions }
    }
}

/// Returns the beams of the array at every pixel, from the cache or computed and added to it.
fn cached_beams(antennas: &Antennas, plane: &ImagePlane) -> Arc<Beams> {
    let find = |tables: &[CachedTable]| {
        let is_equal = |((positions, drawn), _): &&CachedTable| *positions == antennas.positions && drawn == plane;
        tables.iter().find(is_equal).map(|(_, beams)| Arc::clone(beams))
    };
    if let Some(beams) = find(&TABLES.read().unwrap_or_else(PoisonError::into_inner)) {
        return beams;
    }
    let beams = Arc::new(Beams::new(antennas, plane));
    let mut tables = TABLES.write().unwrap_or_else(PoisonError::into_inner);
    if let Some(stored) = find(&tables) {
        return stored; // another thread was faster; all threads share its table
    }
    tables.insert(0, ((antennas.positions.clone(), plane.clone()), Arc::clone(&beams)));
    // The oldest tables go first: after one without room, all are dropped.
    let mut room = KEPT * beams.block_count() * plane.sampling.stride.pow(2);
    tables.retain(|(_, beams)| {
        let fits = beams.block_count() <= room;
        room -= if fits { beams.block_count() } else { room };
        fits
    });
    beams
}

/// Values that depend on the geometry only: the waves of all splats `[N, K]`, and the beams.
struct Steered {
    waves: Vec<[Real; 2]>,
    beams: Arc<Beams>,
}

/// Returns the field h of the array, the sum of all waves, `[channels/2, K]` complex numbers, from `waves` `[N, K]`.
fn array_field(
    splats: &Splats,
    signals: &[Real],
    waves: &[[Real; 2]],
    elements: usize,
    channels: usize,
) -> Vec<[Real; 2]> {
    assert!(channels.is_multiple_of(2), "complex signals come as pairs of channels");
    let mut field = vec![[0.0; 2]; channels / 2 * elements];
    field.par_chunks_exact_mut(elements).enumerate().with_min_len(4).for_each(|(b, h)| {
        for (i, wave) in waves.chunks_exact(elements).enumerate() {
            let o = splats.opacities[i];
            let pair = &signals[i * channels + 2 * b..][..2];
            let (x, y) = (o * pair[0], o * pair[1]);
            if splats.radii[i] > 0.0 {
                for k in 0..h.len() {
                    let [re, im] = wave[k];
                    h[k] = [h[k][0] + x * re - y * im, h[k][1] + x * im + y * re];
                }
            }
        }
    });
    field
}

/// Computes the derivative of [`array_field`] for one splat: fills `d_signals` `[channels]`, adds to `d_wave` `[K]`, returns
/// the cotangent of the opacity.
fn array_field_vjp(
    opacity: Real,
    signals: &[Real],
    wave: &[[Real; 2]],
    d_field: &[[Real; 2]],
    d_signals: &mut [Real],
    d_wave: &mut [[Real; 2]],
) -> Real {
    let mut d_opacity = 0.0;
    let transmitters = signals.chunks_exact(2).zip(d_signals.chunks_exact_mut(2));
    for ((s, d_s), d_h) in transmitters.zip(d_field.chunks_exact(wave.len())) {
        let (mut d_x, mut d_y) = (0.0, 0.0);
        let (d_h, d_wave) = (&d_h[..wave.len()], &mut d_wave[..wave.len()]);
        for k in 0..wave.len() {
            let ([re, im], [d_re, d_im]) = (wave[k], d_h[k]);
            d_x += re * d_re + im * d_im;
            d_y += re * d_im - im * d_re;
            d_wave[k][0] += opacity * (s[0] * d_re + s[1] * d_im);
            d_wave[k][1] += opacity * (s[0] * d_im - s[1] * d_re);
        }
        d_opacity += s[0] * d_x + s[1] * d_y;
        (d_s[0], d_s[1]) = (opacity * d_x, opacity * d_y);
    }
    d_opacity
}

//! Drawing of Gaussians on a GPU: activation, projection, tile lists, blending, readout and loss, with the backward pass.
//! The kernels are in the folder `draw`.
//!
//! ```text
//! CLOUD, VIEW, TERMS ─► project ─► SPLATS ─► blend ─► PIXELS ─► read_out ─► IMAGE
//! IMAGE, TRUTHS ─► blur_moments ─► MOMENTS ─► similarity ─► D_SIMILARITY ─► blur_d_similarity ─► loss_vjp ─► D_IMAGE
//! IMAGE, TRUTHS, D_SIMILARITY ─► sum_loss ─► LOSSES
//! D_IMAGE ─► read_out_vjp ─► D_PIXELS ─► blend_vjp over the LISTS ─► PARTS ─► sum_tiles ─► D_SPLATS ─► project_vjp ─► D_ROWS
//! ```

use crate::adapters::Gpu;
use crate::step::{ARGUMENTS, GpuStep};
use crate::workspace::Workspace;
use pwrfgs_core::{Error, Real, Result};
use std::sync::{Mutex, PoisonError};

/// Slot of the Gaussians in depth order, `[N, 13]`: mean, log scales, rotation, opacity logit, gate, existence.
pub const CLOUD: usize = 0;
/// Slot of the view: 19 constants of the projection, stride and offsets of the sampled pixels, rows of the whole image.
pub const VIEW: usize = 1;
/// Slot of the terms of the network for scales and rotation, `[N, 7]`.
pub const TERMS: usize = 2;
/// Slot of the signals, `[N, links · channels]`.
pub const SIGNALS: usize = 3;
/// Slot of the splats, `[N, 12]`: mean, conic, opacity, existence, half the sides of the box, radius; two columns are unused.
pub const SPLATS: usize = 4;
/// Slot of the blended signals `[links, 2, H·W]`; the lengths of the tile lists follow.
pub const PIXELS: usize = 5;
/// Slot of the values `[links, H·W]`.
pub const IMAGE: usize = 6;
/// Slot of the cotangents of the values `[links, H·W]`.
pub const D_IMAGE: usize = 7;
/// Slot of the cotangents of the blended signals, and their products with the pixels, `[links, 3, H·W]`; before them of
/// means along rows for SSIM, `[links, 4, H·W]`.
pub const D_PIXELS: usize = 8;
/// Slot [`D_PIXELS`] during the loss.
const MOMENTS: usize = D_PIXELS;
/// Slot of the offsets of the tile lists `[tiles + 1]`; the lists follow.
pub const LISTS: usize = 9;
/// Slot of the derivatives of the entries of the lists.
const PARTS: usize = 10;
/// Slot of the derivatives by the splats, `[N, 8 + links · channels]`: mean, conic, opacity, weight, existence, signals.
pub const D_SPLATS: usize = 11;
/// Slot of the derivatives by the Gaussians, `[N, 20]`: mean, log scales, rotation, logit, gate, scale terms, rotation terms,
/// and the radius.
pub const D_ROWS: usize = 12;
/// Slot of the measured images `[links, H·W]`.
pub const TRUTHS: usize = 13;
/// Slot of the derivatives of the similarity of SSIM, and of the similarity, `[links, 4, H·W]`.
const D_SIMILARITY: usize = 14;
/// Slot of the taps of the window of SSIM, and the shares of the error and of SSIM of a pixel in the loss.
pub const LOSS: usize = 15;
/// Slot of the sums of errors and of 1 - similarity over pixels, `[links, 2]`.
pub const LOSSES: usize = 16;

/// Values per Gaussian in slots [`CLOUD`], [`TERMS`], [`SPLATS`] and [`D_ROWS`]. The kernels repeat these and the following
/// numbers.
pub const WIDTHS: [usize; 4] = [13, 7, 12, 20];
/// Values per Gaussian in slot [`D_SPLATS`] before those of the signals.
pub const GEOMETRY: usize = 8;
/// Column of the blending weights in slot [`D_SPLATS`].
pub const WEIGHT: usize = 6;
/// Column of the derivatives by the existence factors in slot [`D_SPLATS`].
pub const EXISTENCE: usize = 7;
/// Values per entry of a list in slot [`PARTS`].
const PART: usize = 10;
/// Number of constants in slot [`VIEW`].
pub const VIEW_LEN: usize = 23;
/// Number of constants in slot [`LOSS`].
pub const LOSS_LEN: usize = 13;
/// Number of entries of tile lists in the first buffers.
const FIRST_ENTRIES: usize = 4096;
/// Maximum number of entries of all tile lists, 2²⁴: kernels store counts as single-precision numbers.
const MOST_ENTRIES: f64 = 16_777_216.0;
/// Pixels along the side of a tile.
const SIDE: usize = 16;
/// Invocations per workgroup of the kernels per pixel, and per Gaussian.
const PIXEL_LANES: usize = 256;
const GAUSSIAN_LANES: usize = 64;

/// Conversion of blended signals to values; the numbers are those of `readout.wgsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GpuReadout {
    /// First channel.
    Real = 0,
    /// Magnitude.
    Magnitude = 1,
    /// Power.
    Power = 2,
    /// Magnitude from 0 at its smallest to 1 at its largest value.
    MinMax = 3,
}

/// Shape of a drawing: Gaussians with one geometry, and their signals for some transmitters.
#[derive(Clone, Copy, Debug)]
pub struct Drawing {
    /// Number of Gaussians N.
    pub gaussians: usize,
    /// Number of transmitters.
    pub links: usize,
    /// Columns and rows of the image.
    pub size: (usize, usize),
    /// Number of channels per transmitter.
    pub channels: usize,
    /// Conversion to values.
    pub readout: GpuReadout,
    /// Whether slot [`TERMS`] has terms.
    pub has_terms: bool,
}

impl Drawing {
    /// Returns the number of pixels of an image.
    pub fn pixels(&self) -> usize {
        self.size.0 * self.size.1
    }

    /// Returns the number of tiles of an image.
    pub fn tiles(&self) -> usize {
        self.size.0.div_ceil(SIDE) * self.size.1.div_ceil(SIDE)
    }

    /// Returns the number of values per Gaussian in slot [`D_SPLATS`].
    pub fn derivatives(&self) -> usize {
        GEOMETRY + self.links * self.channels
    }

    /// Returns the sizes of all slots in their order, for a backward pass with at least `entries` entries of the tile lists;
    /// `None` for a drawing alone.
    pub fn sizes(&self, entries: Option<usize>) -> Vec<usize> {
        let &Self { gaussians: n, links, channels, .. } = self;
        let [cloud, terms, splats, rows] = WIDTHS.map(|width| n * width);
        let (images, signals) = (links * self.pixels(), n * links * channels);
        let mut sizes = vec![cloud, VIEW_LEN, terms, signals, splats, 2 * images + self.tiles(), images];
        sizes.resize(LOSSES + 1, 1);
        if let Some(entries) = entries {
            let entries = entries.next_power_of_two(); // lists differ from step to step
            let (lists, d_splats) = (self.tiles() + 1 + entries, n * self.derivatives());
            sizes[D_IMAGE..TRUTHS].copy_from_slice(&[images, 4 * images, lists, PART * entries, d_splats, rows]);
            sizes[TRUTHS..].copy_from_slice(&[images, 4 * images, LOSS_LEN, 2 * links]);
        }
        sizes
    }

    /// Returns the number of entries of tile lists with these `lengths`.
    ///
    /// # Errors
    /// [`Error::Config`] if there are more than 2²⁴, which kernels cannot count.
    pub fn entry_count(lengths: &[Real]) -> Result<usize> {
        let entries: f64 = lengths.iter().map(|&length| f64::from(length)).sum();
        if entries <= MOST_ENTRIES {
            return Ok(entries as usize);
        }
        let advice = "use fewer or smaller Gaussians, or the CPU";
        Err(Error::Config(format!("--device: tile lists with {entries} entries, at most {MOST_ENTRIES}; {advice}")))
    }

    /// Returns the arguments of a kernel in the order of `Op` of `common.wgsl`; `link` is the transmitter of a backward pass.
    /// The meaning of `mode` differs by kernel.
    fn arguments(&self, link: usize, mode: usize) -> [usize; ARGUMENTS] {
        let &Self { gaussians, links, size: (width, height), channels, .. } = self;
        let columns = width.div_ceil(SIDE);
        [gaussians, links, link, width, height, columns, self.tiles(), channels, mode, 0, 0, 0, 0, 0, 0, 0]
    }

    /// Records activation and projection, from slots [`CLOUD`], [`VIEW`] and [`TERMS`] to [`SPLATS`].
    pub fn project(&self, step: &mut GpuStep<'_>) {
        let arguments = self.arguments(0, usize::from(self.has_terms));
        step.pass("project", [CLOUD, TERMS, VIEW, CLOUD, SPLATS], arguments, self.gaussian_groups());
    }

    /// Records the blending of [`SPLATS`] with [`SIGNALS`], to [`PIXELS`].
    pub fn blend(&self, step: &mut GpuStep<'_>) {
        let groups = [self.tiles(), self.links, 1];
        step.pass("blend", [SPLATS, SIGNALS, SPLATS, SPLATS, PIXELS], self.arguments(0, 0), groups);
    }

    /// Records the readout, from [`PIXELS`] to [`IMAGE`].
    pub fn read_out(&self, step: &mut GpuStep<'_>) {
        let arguments = self.arguments(0, self.readout as usize);
        step.pass("read_out", [PIXELS, PIXELS, PIXELS, PIXELS, IMAGE], arguments, [self.links, 1, 1]);
    }

    /// Records the backward pass of [`Self::read_out`], from [`D_IMAGE`] to [`D_PIXELS`].
    pub fn read_out_vjp(&self, step: &mut GpuStep<'_>) {
        let arguments = self.arguments(0, self.readout as usize);
        step.pass("read_out_vjp", [PIXELS, D_IMAGE, PIXELS, PIXELS, D_PIXELS], arguments, [self.links, 1, 1]);
    }

    /// Records the loss of [`IMAGE`] against [`TRUTHS`] with the constants in [`LOSS`], to [`LOSSES`], and its derivative, to
    /// [`D_IMAGE`]: absolute or squared errors, with or without the term of SSIM.
    pub fn loss(&self, step: &mut GpuStep<'_>, is_squared: bool, has_ssim: bool) {
        // The bits of `mode` in `loss.wgsl`.
        let arguments = self.arguments(0, usize::from(is_squared) + 2 * usize::from(has_ssim));
        let per_pixel = [self.pixels().div_ceil(PIXEL_LANES), self.links, 1];
        if has_ssim {
            step.pass("blur_moments", [IMAGE, TRUTHS, LOSS, IMAGE, MOMENTS], arguments, per_pixel);
            step.pass("similarity", [IMAGE, IMAGE, LOSS, MOMENTS, D_SIMILARITY], arguments, per_pixel);
            step.pass("blur_d_similarity", [D_SIMILARITY, IMAGE, LOSS, IMAGE, MOMENTS], arguments, per_pixel);
        }
        step.pass("loss_vjp", [IMAGE, TRUTHS, LOSS, MOMENTS, D_IMAGE], arguments, per_pixel);
        step.pass("sum_loss", [IMAGE, TRUTHS, LOSS, D_SIMILARITY, LOSSES], arguments, [self.links, 1, 1]);
    }

    /// Records the backward pass of [`Self::blend`], from [`D_PIXELS`] to [`D_SPLATS`]. Its results are not valid if the tile
    /// lists have more entries than [`Self::sizes`] was given.
    pub fn blend_vjp(&self, step: &mut GpuStep<'_>) {
        step.clear(D_SPLATS, self.gaussians * self.derivatives());
        let tiles = [if self.gaussians > 0 { self.tiles() } else { 0 }, 1, 1];
        step.pass("offsets", [PIXELS, PIXELS, PIXELS, PIXELS, LISTS], self.arguments(0, 0), [1, 1, 1]);
        step.pass("list", [SPLATS, SPLATS, SPLATS, SPLATS, LISTS], self.arguments(0, 0), tiles);
        for link in 0..self.links {
            let arguments = self.arguments(link, 0);
            step.pass("blend_vjp", [SPLATS, SIGNALS, LISTS, D_PIXELS, PARTS], arguments, tiles);
            step.pass("sum_tiles", [SPLATS, LISTS, PARTS, SPLATS, D_SPLATS], arguments, self.gaussian_groups());
        }
    }

    /// Records the backward pass of [`Self::project`], from [`D_SPLATS`] to [`D_ROWS`].
    pub fn project_vjp(&self, step: &mut GpuStep<'_>) {
        let arguments = self.arguments(0, usize::from(self.has_terms));
        step.pass("project_vjp", [CLOUD, TERMS, VIEW, D_SPLATS, D_ROWS], arguments, self.gaussian_groups());
    }

    /// Returns the workgroups of a kernel with an invocation per Gaussian.
    fn gaussian_groups(&self) -> [usize; 3] {
        [self.gaussians.div_ceil(GAUSSIAN_LANES), 1, 1]
    }
}

impl Gpu {
    /// Returns the number of entries of tile lists that the buffers of drawings hold, at least 4,096.
    pub fn list_entries(&self) -> usize {
        list_capacity(&self.drawings, 0)
    }

    /// Returns the same as [`Self::list_entries`] for the buffers of whole training steps; `drawing` is the first slot of their
    /// drawing.
    pub fn resident_list_entries(&self, drawing: usize) -> usize {
        list_capacity(&self.training, drawing)
    }

    /// Begins a step that draws, with buffers of at least `sizes` numbers by slot. The buffers are not those of networks.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn drawing_step(&self, sizes: &[usize]) -> Result<GpuStep<'_>> {
        self.step_in(&self.drawings, sizes, "use a smaller `training.batch`, fewer Gaussians, or the CPU")
    }
}

/// Returns the number of entries of tile lists that buffers hold, at least [`FIRST_ENTRIES`], for a drawing whose first slot
/// is `first`.
fn list_capacity(workspace: &Mutex<Workspace>, first: usize) -> usize {
    let workspace = workspace.lock().unwrap_or_else(PoisonError::into_inner);
    let bytes = workspace.buffers.get(first + PARTS).map_or(0, |buffer| buffer.size() as usize);
    (bytes / (size_of::<f32>() * PART)).max(FIRST_ENTRIES)
}

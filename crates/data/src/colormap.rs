//! Colour maps of spectra that were saved as figures, and the values that their colours stand for.

use clap::ValueEnum;
use image::RgbImage;
use pwrfgs_core::JsonSchema;
use serde::{Deserialize, Serialize};

/// Colour map of images, from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, ValueEnum)]
pub enum Colormap {
    /// `jet` of Matplotlib: dark blue, cyan, yellow, dark red.
    Jet,
    /// `turbo` of Google.
    Turbo,
    /// `viridis` of Matplotlib.
    Viridis,
}

/// Value and brightness at the corners of red, green and blue of jet, which is linear between them.
const JET: [&[(f64, f64)]; 3] = [
    &[(0.0, 0.0), (0.35, 0.0), (0.66, 1.0), (0.89, 1.0), (1.0, 0.5)],
    &[(0.0, 0.0), (0.125, 0.0), (0.375, 1.0), (0.64, 1.0), (0.91, 0.0), (1.0, 0.0)],
    &[(0.0, 0.5), (0.11, 1.0), (0.34, 1.0), (0.65, 0.0), (1.0, 0.0)],
];
/// Colours of turbo (Mikhailov, Google, 2019) and viridis (van der Walt and Smith, 2015) at 33 equidistant values; linear
/// interpolation differs from the maps by at most 2 of 255.
#[allow(clippy::unreadable_literal)] // red, green, blue
const TURBO: [u32; 33] = [
    0x30123b, 0x392a73, 0x4040a1, 0x4456c7, 0x466be3, 0x467ff6, 0x4293ff, 0x37a7fa, 0x29bbec, 0x1dcdd8, 0x18dcc3,
    0x1ee8b0, 0x31f299, 0x4cf97e, 0x6bfd64, 0x8aff4d, 0xa3fd3c, 0xb8f735, 0xcced34, 0xdee037, 0xedd03a, 0xf8c03a,
    0xfdae35, 0xfe982c, 0xfb8022, 0xf56817, 0xec520f, 0xe04009, 0xd23105, 0xc02302, 0xac1701, 0x950d01, 0x7a0403,
];
/// Colours of viridis, see [`TURBO`].
#[allow(clippy::unreadable_literal)] // red, green, blue
const VIRIDIS: [u32; 33] = [
    0x440154, 0x470d60, 0x48186a, 0x482374, 0x472d7b, 0x453681, 0x424086, 0x3f4989, 0x3b528b, 0x375a8d, 0x33638d,
    0x2f6a8e, 0x2c728e, 0x297a8e, 0x26818e, 0x23898e, 0x21908c, 0x1f988b, 0x1f9f88, 0x21a685, 0x28ae80, 0x31b57b,
    0x3ebc74, 0x4cc26c, 0x5dc963, 0x6ece58, 0x82d34c, 0x96d83f, 0xabdc32, 0xc0df24, 0xd5e21a, 0xeae51a, 0xfde725,
];
/// Largest difference of red, green and blue of a grey pixel.
const GREY: u8 = 48;
/// Largest distance of a colour from the map, of 255 per channel: twice the noise of a JPEG image.
const NEAR: i32 = 24;
/// Smallest number of pixels from which the map of a larger image is recognised.
const SAMPLED: usize = 10_000;
/// Smallest number of values of an image in which a map is recognised: a few colours lie on every map.
const FEWEST: usize = 16;

impl Colormap {
    /// Returns the name in Matplotlib.
    pub fn name(self) -> String {
        format!("{self:?}").to_lowercase()
    }

    /// Returns the colour of a value from 0 to 1: red, green and blue from 0 to 255.
    fn colour(self, value: f64) -> [f64; 3] {
        let nodes = match self {
            Self::Jet => return JET.map(|nodes| 255.0 * interpolate(nodes, value)),
            Self::Turbo => &TURBO,
            Self::Viridis => &VIRIDIS,
        };
        let position = value * (nodes.len() - 1) as f64;
        let first = (position as usize).min(nodes.len() - 2);
        let channel = |k: usize, shift: usize| f64::from(nodes[k] >> shift & 0xff);
        let mix = |shift| {
            channel(first, shift) + (position - first as f64) * (channel(first + 1, shift) - channel(first, shift))
        };
        [16, 8, 0].map(mix)
    }

    /// Returns the colours of the 8-bit values.
    fn table(self) -> [[i32; 3]; 256] {
        std::array::from_fn(|i| self.colour(i as f64 / 255.0).map(|v| v.round() as i32))
    }

    /// Returns the 8-bit values `[H,W]` whose colours are nearest to those of an image: the middle of several values of one
    /// colour.
    ///
    /// # Errors
    /// Returns the problem if more than 5 % of the pixels are far from the map.
    pub(crate) fn invert(self, image: &RgbImage) -> Result<Vec<u8>, String> {
        let table = self.table();
        let nearest = image.pixels().map(|pixel| nearest(&table, pixel.0));
        let (values, distances): (Vec<u8>, Vec<i32>) = nearest.unzip();
        let far = distances.iter().filter(|squared| **squared > NEAR * NEAR).count();
        if 20 * far <= values.len() {
            return Ok(values);
        }
        let (percent, name) = (100 * far / values.len().max(1), self.name());
        Err(format!(
            "{percent} % of its pixels are not colours of {name}; cut off axes and frames, or name another map"
        ))
    }

    /// Returns the map on which at least 90 % of the pixels of an image lie, the nearest one if there are several; `None` for a
    /// grey image, other colours, and fewer than [`FEWEST`] values.
    pub(crate) fn recognise(image: &RgbImage) -> Option<Self> {
        let step = (image.width() as usize * image.height() as usize / SAMPLED).max(1);
        let pixels: Vec<[u8; 3]> = image.pixels().step_by(step).map(|pixel| pixel.0).collect();
        let is_saturated = |[r, g, b]: &&[u8; 3]| r.max(g).max(b).abs_diff(*r.min(g).min(b)) > GREY;
        // An image counts as grey if less than a quarter of its pixels have a colour.
        if 4 * pixels.iter().filter(is_saturated).count() < pixels.len() {
            return None;
        }
        let distance_to = |map: Self| {
            let table = map.table();
            let (mut values, distances): (Vec<u8>, Vec<i32>) =
                pixels.iter().map(|pixel| nearest(&table, *pixel)).unzip();
            let near = distances.iter().filter(|squared| **squared <= NEAR * NEAR).count();
            values.sort_unstable();
            values.dedup();
            let is_on_map = values.len() >= FEWEST && 10 * near >= 9 * pixels.len();
            let total = distances.iter().map(|squared| i64::from(*squared)).sum::<i64>();
            is_on_map.then_some((total, map))
        };
        Self::value_variants()
            .iter()
            .copied()
            .filter_map(distance_to)
            .min_by_key(|(total, _)| *total)
            .map(|(_, map)| map)
    }
}

/// Returns the index of the colour of a table that is nearest to `colour`, and the squared distance; in a tie, the middle of
/// the first and the last such index.
fn nearest(table: &[[i32; 3]; 256], colour: [u8; 3]) -> (u8, i32) {
    let squared = |to: &[i32; 3]| (0..3).map(|k| (to[k] - i32::from(colour[k])).pow(2)).sum::<i32>();
    let (mut first, mut last, mut least) = (0, 0, i32::MAX);
    for (i, to) in table.iter().enumerate() {
        let distance = squared(to);
        if distance < least {
            (first, least) = (i, distance);
        }
        if distance == least {
            last = i;
        }
    }
    (usize::midpoint(first, last) as u8, least)
}

/// Returns the value at `x` of the line through `nodes`, which begin at 0 and end at 1.
fn interpolate(nodes: &[(f64, f64)], x: f64) -> f64 {
    let right = nodes.iter().position(|(at, _)| *at >= x).unwrap_or(nodes.len() - 1).max(1);
    let ((x0, y0), (x1, y1)) = (nodes[right - 1], nodes[right]);
    y0 + (y1 - y0) * (x - x0) / (x1 - x0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::read_image;
    use image::Rgb;
    use pwrfgs_core::testing::shared;

    /// Returns an image of 64 x 64 pixels with all values of a map, and a different number of each.
    fn image(map: Colormap) -> (RgbImage, Vec<u8>) {
        let value = |x: u32, y: u32| ((x * x + 3 * y) % 256) as u8;
        let table = map.table();
        let image = RgbImage::from_fn(64, 64, |x, y| Rgb(table[usize::from(value(x, y))].map(|v| v as u8)));
        let values = (0..64).flat_map(|y| (0..64).map(move |x| value(x, y))).collect();
        (image, values)
    }

    #[test]
    fn maps_have_the_colours_of_matplotlib() {
        for (map, value, colour) in [
            (Colormap::Jet, 0, [0, 0, 128]),
            (Colormap::Jet, 128, [125, 255, 122]),
            (Colormap::Jet, 255, [128, 0, 0]),
            (Colormap::Turbo, 0, [48, 18, 59]),
            (Colormap::Turbo, 128, [164, 252, 60]),
            (Colormap::Turbo, 255, [122, 4, 3]),
            (Colormap::Viridis, 0, [68, 1, 84]),
            (Colormap::Viridis, 128, [33, 145, 140]),
            (Colormap::Viridis, 255, [253, 231, 37]),
        ] {
            let got = map.table()[value];
            assert!(got.iter().zip(colour).all(|(a, b)| (a - b).abs() <= 2), "{map:?} {value}: {got:?}");
        }
    }

    #[test]
    fn colours_are_inverted_and_their_map_is_recognised() {
        for map in [Colormap::Jet, Colormap::Turbo, Colormap::Viridis] {
            let (image, values) = image(map);
            assert_eq!(Colormap::recognise(&image), Some(map));
            let inverted = map.invert(&image).unwrap();
            let error = |(a, b): (&u8, &u8)| a.abs_diff(*b);
            let largest = inverted.iter().zip(&values).map(error).max().unwrap();
            assert!(largest <= 2, "{map:?}: {largest}");
            for other in [Colormap::Jet, Colormap::Turbo].into_iter().filter(|other| *other != map) {
                let message = other.invert(&image).unwrap_err();
                assert!(message.contains(&format!("of its pixels are not colours of {}", other.name())), "{message}");
            }
            assert_eq!(Colormap::from_str(&map.name().to_uppercase(), true), Ok(map));
        }
    }

    #[test]
    fn photographs_and_grey_images_have_no_map() {
        let grey = RgbImage::from_fn(64, 64, |x, y| Rgb([(x * y % 256) as u8; 3]));
        let sky = RgbImage::from_fn(64, 64, |x, y| Rgb([(60 + x) as u8, (120 + y) as u8, (255 - x - y) as u8]));
        let flag = RgbImage::from_fn(64, 64, |x, _| Rgb(if x < 32 { [255, 0, 0] } else { [0, 0, 255] }));
        for image in [grey, sky, flag] {
            assert_eq!(Colormap::recognise(&image), None);
        }
    }

    /// The jet image of one spectrum equals its grey image, except for the six values of pure blue.
    #[test]
    fn shared_jet_images_equal_grey_images() {
        let Some(folder) = shared("cases/radio") else { return };
        for k in 1..=12 {
            let name = |map: &str| folder.join(format!("images-{map}/images/{k:03}.png"));
            let grey = image::open(name("grey")).unwrap().into_luma8().into_raw();
            let jet = image::open(name("jet")).unwrap().into_rgb8();
            assert_eq!(Colormap::recognise(&jet), Some(Colormap::Jet));
            let inverted = Colormap::Jet.invert(&jet).unwrap();
            for ((a, b), colour) in grey.iter().zip(&inverted).zip(jet.pixels()) {
                let most = if colour.0 == [0, 0, 255] { 3 } else { 1 };
                assert!(a.abs_diff(*b) <= most, "{a} {b} {colour:?}");
            }
            let refused = read_image(&name("jet")).unwrap_err().to_string();
            assert!(refused.contains("the colour map jet") && refused.contains("--colormap jet"), "{refused}");
        }
    }
}

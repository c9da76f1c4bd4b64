//! Spectra: an array and a picture a row, or one array of all.

use super::folder::{Folder, SPREAD, Stack, name};
use super::{Drawn, Row, Writer};
use pwrfgs::model::Prepared;
use pwrfgs_core::{Image, ImagePlane, Real, Result};
use rayon::prelude::*;

const STACKS: [&str; 2] = ["spectra.npy", "spread.npy"];

/// Spectra under way.
pub(super) struct Spectra<'a> {
    plane: &'a ImagePlane,
    has_names: bool,
    stacks: Vec<Stack>,
}

impl<'a> Spectra<'a> {
    pub(super) fn begin(folder: &Folder<'_>, model: &Prepared<'a>, count: usize, stacked: bool) -> Result<Self> {
        let plane = model.plane();
        let size = [count, plane.height, plane.width];
        let names = STACKS.into_iter().take(model.models().count().min(2)).filter(|_| stacked);
        let stacks = names.map(|name| Stack::floats(folder, name, size)).collect::<Result<_>>()?;
        Ok(Self { plane, has_names: model.receivers().len() > 1, stacks })
    }
}

impl Writer for Spectra<'_> {
    fn header(&self) -> String {
        let receiver = if self.has_names { "receiver," } else { "" };
        format!("row,x,y,z,{receiver}azimuth_deg,elevation_deg,peak,milliseconds\n")
    }

    fn take(&mut self, folder: &Folder<'_>, rows: &[Row<'_>], drawn: &[Drawn], list: &mut String) -> Result<()> {
        let images: Vec<&Image> = drawn.iter().map(|drawn| &drawn.image).collect();
        let spreads: Vec<&Image> = drawn.iter().filter_map(|drawn| drawn.spread.as_ref()).collect();
        let kinds = [("", 1.0, images), (SPREAD, 2.0, spreads)];
        for (k, (suffix, gain, images)) in kinds.iter().enumerate() {
            let one = |(image, row): (&&Image, &Row<'_>)| {
                let name = name(row.number) + suffix;
                if self.stacks.is_empty() {
                    folder.array(&name, image)?;
                }
                folder.picture(&name, image, *gain as Real)
            };
            images.par_iter().zip(rows).map(one).collect::<Result<Vec<()>>>()?;
            if let Some(stack) = self.stacks.get_mut(k) {
                images.iter().try_for_each(|image| stack.push_floats(image))?;
            }
        }
        for (row, drawn) in rows.iter().zip(drawn) {
            *list += &line(self.plane, row, &drawn.image, drawn.milliseconds);
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.stacks.into_iter().try_for_each(Stack::finish)
    }
}

/// A row of `predictions.csv`; without angles where the model's plane has none.
fn line(plane: &ImagePlane, row: &Row<'_>, image: &Image, milliseconds: f64) -> String {
    let strongest = image.argmax();
    let (column, line) = ((strongest % image.width) as Real, (strongest / image.width) as Real);
    let angles = plane.azimuth_elevation_deg(column, line);
    let angles = angles.map_or_else(|| ",".into(), |(az, el)| format!("{az},{el}"));
    format!("{},{angles},{},{milliseconds:.3}\n", row.begin(), image.pixels[strongest])
}

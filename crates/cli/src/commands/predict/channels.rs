//! Channels: an array of complex numbers a row, or one array of all.

use super::folder::{Folder, SPREAD, Stack, name};
use super::{Drawn, Row, Writer};
use pwrfgs::model::Prepared;
use pwrfgs_core::{Image, Real, Result, Task, gains_of};
use std::fmt::Write as _;

const STACKS: [&str; 2] = ["channels.npy", "spread.npy"];

/// Channels under way.
pub(super) struct Channels {
    task: Task,
    stacks: Vec<Stack>,
}

impl Channels {
    pub(super) fn begin(folder: &Folder<'_>, model: &Prepared<'_>, count: usize, stacked: bool) -> Result<Self> {
        let size = [count, model.plane().height / 2, model.plane().width];
        let mut stacks = Vec::new();
        if stacked {
            stacks.push(Stack::complex(folder, STACKS[0], size)?);
            if model.models().count() > 1 {
                stacks.push(Stack::floats(folder, STACKS[1], size)?);
            }
        }
        Ok(Self { task: model.task(), stacks })
    }
}

impl Writer for Channels {
    fn header(&self) -> String {
        "row,x,y,z,receiver,db,ms\n".into()
    }

    fn take(&mut self, folder: &Folder<'_>, rows: &[Row<'_>], drawn: &[Drawn], list: &mut String) -> Result<()> {
        for (row, Drawn { image, spread, milliseconds }) in rows.iter().zip(drawn) {
            let (gains, name) = (gains_of(&image.pixels, image.width), name(row.number));
            let spread = spread.as_ref().map(lengths);
            if let Some(stack) = self.stacks.first_mut() {
                stack.push_complex(&gains)?;
            } else {
                folder.gains(&name, [image.height / 2, image.width], &gains)?;
            }
            match (self.stacks.get_mut(1), &spread) {
                (Some(stack), Some(spread)) => stack.push_floats(spread)?,
                (None, Some(spread)) => folder.array(&(name + SPREAD), spread)?,
                _ => {}
            }
            _ = writeln!(list, "{},{:.4},{milliseconds:.3}", row.begin(), self.task.level(image));
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        self.stacks.into_iter().try_for_each(Stack::finish)
    }
}

/// How far complex gains are apart, from the standard deviations of their two parts.
fn lengths(parts: &Image) -> Image {
    let pixels: Vec<Real> = gains_of(&parts.pixels, parts.width).iter().map(|[re, im]| re.hypot(*im)).collect();
    Image { width: parts.width, height: parts.height / 2, pixels }
}

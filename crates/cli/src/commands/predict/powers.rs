//! Received powers: a line of the list each, and nothing else.

use super::folder::Folder;
use super::{Drawn, Row, Writer};
use pwrfgs_core::Result;
use std::fmt::Write as _;

/// Powers under way.
pub(super) struct Powers {
    /// Whether several models say how far they differ.
    pub(super) has_spread: bool,
}

impl Writer for Powers {
    fn header(&self) -> String {
        format!("row,x,y,z,receiver,dbm,{}ms\n", if self.has_spread { "spread_db," } else { "" })
    }

    fn take(&mut self, _: &Folder<'_>, rows: &[Row<'_>], drawn: &[Drawn], list: &mut String) -> Result<()> {
        for (row, Drawn { image, spread, milliseconds }) in rows.iter().zip(drawn) {
            let spread = spread.as_ref().map_or_else(String::new, |spread| format!("{},", spread.pixels[0]));
            _ = writeln!(list, "{},{},{spread}{milliseconds:.3}", row.begin(), image.pixels[0]);
        }
        Ok(())
    }

    fn finish(self: Box<Self>) -> Result<()> {
        Ok(())
    }
}

//! `report.html`: one file with nothing outside it and no script; best is bold, second best underlined.

use super::super::page::{Page, RunLine, Section};
use super::super::tables::{Column, Line, Table};
use crate::run_page::environment;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use minijinja::context;
use minijinja::value::Serde;
use pwrfgs_core::{Error, Result};
use serde::Serialize;

/// A figure that was drawn wider takes the whole page.
const COLUMN_MM: f64 = 120.0;

const TEMPLATE: &str = include_str!("../page.html");

/// A section as the template wants it.
#[derive(Serialize)]
struct Shown<'a> {
    name: &'a str,
    title: &'a str,
    lead: &'a str,
    warnings: &'a [String],
    tables: Vec<ShownTable<'a>>,
    figures: Vec<ShownFigure<'a>>,
    runs: &'a [RunLine],
    notes: &'a [String],
}

#[derive(Serialize)]
struct ShownTable<'a> {
    name: &'a str,
    title: &'a str,
    /// Head of a group and how many columns it spans.
    groups: Vec<(&'a Column, usize)>,
    columns: &'a [Column],
    sections: Vec<&'a [Line]>,
    /// Whether there is anything in the second line of heads.
    has_details: bool,
    legend: Vec<&'a str>,
    marked: bool,
}

#[derive(Serialize)]
struct ShownFigure<'a> {
    title: &'a str,
    caption: &'a str,
    /// As an address that holds it all.
    source: String,
    /// Drawn for more than a column.
    wide: bool,
}

/// The page.
pub(in super::super) fn html(page: &Page) -> Result<String> {
    let sections: Vec<Shown<'_>> = page.sections.iter().map(section).collect();
    let page = context! {
        title => page.title.clone(),
        sections => Serde(sections),
        left_out => page.left_out.clone(),
        version => env!("CARGO_PKG_VERSION"),
    };
    let failed = |e: minijinja::Error| Error::Config(format!("the report's template: {e:#}"));
    let mut environment = environment().map_err(failed)?;
    environment.add_template("page.html", TEMPLATE).map_err(failed)?;
    environment.get_template("page.html").and_then(|t| t.render(page)).map_err(failed)
}

fn section(section: &Section) -> Shown<'_> {
    Shown {
        name: &section.name,
        title: &section.title,
        lead: &section.lead,
        warnings: &section.warnings,
        tables: section.tables().map(|(t, legend)| table(t, legend)).collect(),
        figures: section
            .figures
            .iter()
            .map(|f| ShownFigure {
                title: &f.title,
                caption: &f.caption,
                source: inside(&f.svg),
                wide: super::width_mm(&f.svg).is_none_or(|width| width > COLUMN_MM),
            })
            .collect(),
        runs: &section.runs,
        notes: &section.notes,
    }
}

fn table<'a>(table: &'a Table, legend: Vec<&'a str>) -> ShownTable<'a> {
    ShownTable {
        name: table.name,
        title: &table.title,
        groups: table.groups(),
        columns: &table.columns,
        sections: table.sections().collect(),
        has_details: table.columns.iter().any(|c| !c.detail.is_empty()),
        legend,
        marked: table.is_marked(),
    }
}

/// A picture inside the page. As an image of its own: ids in one SVG do not meet those in another.
fn inside(svg: &str) -> String {
    format!("data:image/svg+xml;base64,{}", STANDARD.encode(svg))
}

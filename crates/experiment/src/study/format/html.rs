//! `report.html`: one file with nothing outside it and no script; best is bold, second best underlined.

use super::super::page::{Page, RunLine, Section};
use super::super::tables::{Column, Line, Table};
use crate::report::environment;
use minijinja::context;
use minijinja::value::Serde;
use pwrfgs_core::{Error, Result};
use serde::Serialize;

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
    svg: &'a str,
    /// Too wide for half the page.
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
            .map(|f| ShownFigure { title: &f.title, caption: &f.caption, svg: inner(&f.svg), wide: is_wide(&f.svg) })
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

/// Whether the picture is much wider than high, or has no `viewBox` to tell.
fn is_wide(svg: &str) -> bool {
    let sizes = svg.split_once("viewBox=\"").and_then(|(_, rest)| rest.split_once('"')).map(|(box_, _)| box_);
    let sizes: Vec<f64> = sizes.unwrap_or("").split([' ', ',']).filter_map(|n| n.parse().ok()).collect();
    !matches!(sizes[..], [_, _, width, height] if width < 2.0 * height)
}

/// An SVG file from its first element on: a page has no place for an XML declaration.
fn inner(svg: &str) -> &str {
    svg.find("<svg").map_or(svg, |start| &svg[start..])
}

//! The files of a map: an array and a picture a layer, and `map.csv`, which says what they are.

use super::layers::Layer;
use super::plane::Grid;
use pwrfgs::data::npy_header;
use pwrfgs::experiment::text::field;
use pwrfgs::report::draw::heat::{Colours, Heat};
use pwrfgs_core::{Error, Number, Pose, Receiver, Result};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;

/// Width of a picture in print.
const WIDTH_MM: f64 = 120.0;
const HEADER: &str = "array,picture,quantity,unit,receiver,columns_axis,first_column_m,columns,rows_axis,first_row_m,rows,\
                      step_m,plane,smallest,largest\n";

/// Writes everything into `folder`; `poses` are the receivers' in the user's frame.
pub(super) fn write(
    folder: &Path,
    grid: &Grid,
    layers: &[Layer],
    receivers: &[Receiver],
    poses: &[Pose],
    mapped: &[usize],
) -> Result<()> {
    let mut list = HEADER.to_owned();
    let mut taken = BTreeSet::new();
    for layer in layers {
        let receiver = layer.receiver.map(|r| receivers[r].name.as_str());
        let name = file_name(layer.name, receiver.filter(|_| receivers.len() > 1), &mut taken);
        let put = |file: String, bytes: &[u8]| {
            let path = folder.join(file);
            std::fs::write(&path, bytes).map_err(|e| Error::write(&path, e))
        };
        put(format!("{name}.npy"), &array(grid, &layer.values))?;
        let shown: Vec<usize> = layer.receiver.map_or_else(|| mapped.to_vec(), |r| vec![r]);
        put(format!("{name}.png"), &picture(grid, layer, receiver, shown.iter().map(|&r| poses[r].position)))?;
        list += &line(grid, layer, &name, receiver.unwrap_or(""));
    }
    let path = folder.join("map.csv");
    std::fs::write(&path, list).map_err(|e| Error::write(&path, e))
}

/// A name of letters, digits, points and dashes that no other layer has, upper and lower case being the same.
fn file_name(layer: &str, receiver: Option<&str>, taken: &mut BTreeSet<String>) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let own = receiver.map(|name| name.chars().take(60).map(plain).collect::<String>());
    let name = own.map_or_else(|| layer.to_owned(), |own| format!("{layer}-{own}"));
    let numbered = (1..).map(|k| if k == 1 { name.clone() } else { format!("{name}-{k}") });
    numbered.into_iter().find(|name| taken.insert(name.to_lowercase())).unwrap_or(name)
}

/// `[rows, columns]` of 32-bit numbers, the lowest row first.
fn array(grid: &Grid, values: &[f32]) -> Vec<u8> {
    let mut npy = npy_header(Number::F32, &[grid.rows, grid.columns]);
    npy.extend(values.iter().flat_map(|v| v.to_le_bytes()));
    npy
}

fn picture(grid: &Grid, layer: &Layer, receiver: Option<&str>, places: impl Iterator<Item = [f64; 3]>) -> Vec<u8> {
    let at = receiver.map_or_else(String::new, |name| format!(" at {name}"));
    let heat = Heat {
        title: format!("{}{at}, {}", layer.words, grid.plane.words()),
        unit: layer.unit.into(),
        names: grid.plane.names(),
        first: grid.first,
        step: grid.step,
        columns: grid.columns,
        values: &layer.values,
        colours: if layer.name == "azimuth" { Colours::Cyclic } else { Colours::Sequential },
        receivers: places.map(|place| grid.plane.flat(place)).collect(),
        arrows: &layer.arrows,
    };
    heat.draw().png(WIDTH_MM)
}

fn line(grid: &Grid, layer: &Layer, name: &str, receiver: &str) -> String {
    let [across, up] = grid.plane.names();
    let finite = || layer.values.iter().copied().filter(|v| v.is_finite());
    let ends = [finite().reduce(f32::min), finite().reduce(f32::max)];
    let [low, high] = ends.map(|end| end.map_or_else(String::new, |v| v.to_string()));
    let mut line = format!("{name}.npy,{name}.png,{},{},{}", layer.words, layer.unit, field(receiver));
    _ = writeln!(
        line,
        ",{across},{},{},{up},{},{},{},{},{low},{high}",
        grid.first[0],
        grid.columns,
        grid.first[1],
        grid.rows,
        grid.step,
        grid.plane.words()
    );
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_plain_and_differ() {
        let mut taken = BTreeSet::new();
        let mut name = |receiver| file_name("power", receiver, &mut taken);
        let names = [name(Some("../a b")), name(Some("../a/b")), name(None), name(Some(&"x".repeat(500)))];
        assert_eq!(names[..3], ["power-.._a_b", "power-.._a_b-2", "power"].map(str::to_owned));
        assert!(names[3].len() < 80);
    }
}

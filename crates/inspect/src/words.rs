//! What was found in words: the same on the page and in the terminal.

use crate::levels::levels;
use crate::{Freedom, Inspection, Pictures};
use pwrfgs_core::{Dataset, Number, Unmatched};
use pwrfgs_experiment::observed;
use pwrfgs_experiment::repeatability::in_order;
use pwrfgs_experiment::text::{grouped, number};

/// Ids that are named one by one.
const NAMED: usize = 5;

/// A name and what is known of it, one a line.
pub(crate) fn facts(found: &Inspection<'_>) -> Vec<(&'static str, String)> {
    let Inspection { data, trajectory: t, .. } = found;
    let [low, high] = t.extent;
    let axis = |k: usize| format!("{} {:.2} to {:.2}", ["x", "y", "z"][k], low[k], high[k]);
    let mut all = vec![("samples", samples(found))];
    if data.placed {
        all.extend([("transmitters", format!("{} m", [0, 1, 2].map(axis).join(", "))), ("steps", steps(found))]);
    }
    all.push(("receiver", receivers(data)));
    match &found.pictures {
        Some((pictures, freedom)) => all.extend(of_pictures(found, pictures, freedom)),
        None => all.extend(levels(data)),
    }
    all
}

fn samples(found: &Inspection<'_>) -> String {
    let [first, last] = found.trajectory.ids;
    format!("{}, ids {first} to {last}", observed(found.data))
}

fn receivers(data: &Dataset) -> String {
    let all = &data.scene.receivers;
    if all.len() > 1 {
        let names: Vec<&str> = all.iter().take(NAMED).map(|receiver| receiver.name.as_str()).collect();
        return format!("{}: {}{}", all.len(), names.join(", "), if all.len() > NAMED { ", .." } else { "" });
    }
    let pose = data.scene.origin.world_pose(data.scene.pose());
    let boresight = pose.world_from_receiver().z_axis.to_array().map(f64::from);
    let boresight = list(boresight.map(|v| (v * 1e3).round() / 1e3));
    format!("at ({}) m, boresight ({boresight})", list(pose.position))
}

fn of_pictures(found: &Inspection<'_>, p: &Pictures, freedom: &Freedom) -> Vec<(&'static str, String)> {
    let Inspection { data, trajectory: t, .. } = found;
    let stored = match p.number {
        Number::U8 => "8-bit grey",
        Number::U16 => "16-bit grey",
        Number::F32 => "32-bit floats",
        Number::F64 => "64-bit floats",
    };
    let mut all = vec![
        ("elevations", format!("{}° to {}°, top row to bottom", data.elevation.first, data.elevation.last)),
        ("grey values", format!("{stored}{}, {:.3} to {:.3}", grain(freedom, p), p.range[0], p.range[1])),
        ("normalisation", p.normalisation()),
        ("odd pictures", odd(p, found)),
        ("halves", halves(found)),
    ];
    if p.looked_at < t.samples {
        let what = "evenly chosen; counts of pictures are of these";
        all.push(("looked at", format!("{} of {} pictures, {what}", count(p.looked_at), count(t.samples))));
    }
    all.push(("numbers", numbers(freedom).join(" ")));
    all
}

pub(crate) fn count(n: usize) -> String {
    grouped(n as i64)
}

fn list(numbers: [f64; 3]) -> String {
    numbers.map(|v| format!("{}", v + 0.0)).join(", ")
}

/// A length in the unit that suits it.
pub(crate) fn length(metres: f64) -> String {
    match metres {
        m if !m.is_finite() => "n/a".into(),
        m if m < 0.1 => format!("{:.1} mm", m * 1e3),
        m if m < 1.0 => format!("{:.0} cm", m * 1e2),
        m => format!("{m:.2} m"),
    }
}

fn steps(found: &Inspection<'_>) -> String {
    let t = &found.trajectory;
    if t.steps.is_empty() {
        return "no two ids follow each other".into();
    }
    let [low, middle, high] = [0.05, 0.5, 0.95].map(|q| length(t.step(q)));
    let kind = if in_order(found.data) {
        "ids follow a trajectory: a random split leaves near neighbours in training"
    } else {
        "ids follow no trajectory: they jump about, so a block of ids is no block of space"
    };
    format!("{middle} from an id to the next in the median ({low} to {high}, 5 % to 95 %); {kind}")
}

/// What floats were made of.
fn grain(freedom: &Freedom, pictures: &Pictures) -> &'static str {
    match (freedom.step, pictures.number) {
        (Some(step), number) if number != Number::U8 && step > 1e-3 => " in 8-bit steps",
        (Some(_), Number::F32 | Number::F64) => " in 16-bit steps",
        _ => "",
    }
}

/// `3 constant (ids 4, 7, 9)`.
fn named(what: &str, ids: &[u32]) -> String {
    if ids.is_empty() {
        return format!("none {what}");
    }
    let shown = ids.iter().take(NAMED).map(u32::to_string).collect::<Vec<_>>().join(", ");
    let more = if ids.len() > NAMED { ", .." } else { "" };
    let word = if ids.len() == 1 { "id" } else { "ids" };
    format!("{} {what} ({word} {shown}{more})", count(ids.len()))
}

fn odd(p: &Pictures, found: &Inspection<'_>) -> String {
    let twins: Vec<u32> = p.twins.iter().flatten().copied().collect();
    let shared = match found.trajectory.shared {
        0 => "none at the position of another".into(),
        n => format!("{} at the position of another", count(n)),
    };
    [named("constant", &p.constant), named("saturated", &p.saturated), named("equal to another", &twins), shared]
        .join(", ")
}

fn halves(found: &Inspection<'_>) -> String {
    let unmatched = found.trajectory.unmatched;
    if unmatched == Unmatched::default() {
        return "every position has its picture, and every picture its position".into();
    }
    let some = |n: usize, what: &str| format!("{} {what}{}", count(n), if n == 1 { "" } else { "s" });
    let (positions, pictures) = (some(unmatched.positions, "position"), some(unmatched.pictures, "picture"));
    format!("{positions} without a picture, {pictures} without a position: left out")
}

/// How many numbers the pictures are made of.
pub(crate) fn numbers(freedom: &Freedom) -> Vec<String> {
    let rounding = match freedom.step {
        Some(_) => format!("rounding (RMS {})", number(freedom.rounding())),
        None => "a millionth".into(),
    };
    let array = freedom.array.map(|array| {
        let size = format!("{} x {} antennas, {:.3} wavelengths apart", array.rows, array.columns, array.spacing);
        let left = format!("RMS {:.2} times that of {rounding}", array.residual);
        if array.explains() {
            format!(
                "Every picture looked at is what an array of {size}, hears: {}. What is left has an {left}. So a picture \
                 has {} numbers, the antennas' signals up to a common phase, seen as {} lags.",
                array.kind.words(),
                array.signals(),
                array.lags()
            )
        } else {
            format!(
                "None of the planar arrays that were tried explains them (2 x 2 to 8 x 8 equally spaced antennas, as far as \
                 there are pixels for it); the nearest, {size}, leaves an {left}."
            )
        }
    });
    let components = freedom.components.as_ref().map(|c| {
        let until = |name: String, k: Option<usize>| match k {
            Some(k) => format!("{k} to {name}"),
            None => format!("more than {} to {name}", c.of),
        };
        let levels = [0.05, 0.02].map(|rms| until(format!("an RMS of {rms}"), c.until(rms)));
        format!(
            "Fixed pictures, mixed, that reproduce others (principal components of {} pictures): {}, {}, {}.",
            c.of,
            levels[0],
            levels[1],
            until(rounding.clone(), c.to_rounding)
        )
    });
    [array, components].into_iter().flatten().collect()
}

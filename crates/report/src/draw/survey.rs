//! Maps of a survey (candidates, known measurements and selected positions) and of coverage (strongest power per transmitter
//! position, and the selected receivers).

use super::plan::FloorPlan;
use crate::canvas::{BLACK, Canvas, Colour, INK, Paint, Point, TEXT, WHITE};
use pwrfgs_core::statistics::bounds;

/// Size of the numbers.
const SMALL: f64 = 10.0;
/// Colour of known measurements.
const KNOWN: Colour = Colour::hex(0x8d_94a1);
/// Radius of a selected position.
const RADIUS: f64 = 2.6;
/// Largest number of selected positions with a number.
const NUMBERED: usize = 9;

/// Positions of a survey, seen from above, metres.
#[derive(Clone, Debug, Default)]
pub struct SurveyMap {
    /// Title above the map.
    pub title: String,
    /// Candidates.
    pub candidates: Vec<Point>,
    /// Known measurements.
    pub known: Vec<Point>,
    /// Selected positions, in the order of selection.
    pub selected: Vec<Point>,
    /// Receivers; those outside the frame of the other positions are not drawn.
    pub receivers: Vec<Point>,
}

impl SurveyMap {
    /// Draws the map. Colours of selected positions run from dark (first) to light (last); the first `NUMBERED` have numbers.
    pub fn draw(&self) -> Canvas {
        let framed = [&self.candidates, &self.known, &self.selected].into_iter().flatten().copied();
        let plan = FloorPlan::around(framed);
        let mut map = plan.empty_map();
        plan.draw_points(&mut map, self.candidates.iter().copied());
        for position in &self.known {
            map.circle(plan.project(*position), 0.7 * RADIUS, Paint::stroke(KNOWN, 1.0));
        }
        let last = self.selected.len().saturating_sub(1).max(1) as f64;
        for (k, position) in self.selected.iter().enumerate().rev() {
            let fill = Paint::fill(Colour::sequential(k as f64 / last));
            map.circle(plan.project(*position), RADIUS, fill.outlined(BLACK, 0.6));
        }
        self.receivers.iter().for_each(|receiver| plan.draw_receiver(&mut map, *receiver));
        let numbered = &self.selected[..self.selected.len().min(NUMBERED)];
        plan.draw_numbers(&mut map, numbered, SMALL, [1.4 * RADIUS, RADIUS]);
        plan.with_title(map, &self.title, &self.note(&plan))
    }

    /// Explains the marks that the map has.
    fn note(&self, plan: &FloorPlan) -> String {
        let mut words = vec!["circles: selected positions, dark first".to_owned(), "grey dots: candidates".into()];
        if !self.known.is_empty() {
            words.push("grey circles: known measurements".into());
        }
        if self.receivers.iter().any(|receiver| plan.contains(*receiver)) {
            words.push("squares: receivers".into());
        }
        words.join("; ")
    }
}

/// Radius of a transmitter position, in sides of a square with the area of the map per position.
const DOT: f64 = 0.3;
/// Smallest and largest radius of a transmitter position.
const DOT_ENDS: [f64; 2] = [1.2, 9.0];

/// Coverage of selected receivers, seen from above, metres.
#[derive(Clone, Debug, Default)]
pub struct CoverageMap {
    /// Title above the map.
    pub title: String,
    /// Positions of transmitters.
    pub transmitters: Vec<Point>,
    /// Strongest power of the selected receivers, dBm, per transmitter.
    pub powers: Vec<f64>,
    /// Selected receivers, in the order of the table.
    pub selected: Vec<Point>,
    /// Receivers that are not selected.
    pub others: Vec<Point>,
}

impl CoverageMap {
    /// Draws the map. Colours run from dark (weakest power) to light (strongest power); transmitters without a finite power are
    /// omitted.
    pub fn draw(&self) -> Canvas {
        let framed = [&self.transmitters, &self.selected, &self.others].into_iter().flatten().copied();
        let plan = FloorPlan::around(framed);
        let mut map = plan.empty_map();
        let finite = self.powers.iter().copied().filter(|v| v.is_finite());
        let (low, high) = bounds(finite);
        let [width, height] = plan.map_area().1;
        let radius = DOT * (width * height / self.transmitters.len().max(1) as f64).sqrt();
        for (position, power) in self.transmitters.iter().zip(&self.powers).filter(|(_, power)| power.is_finite()) {
            let colour = Colour::sequential((power - low) / (high - low).max(1e-9));
            map.circle(plan.project(*position), radius.clamp(DOT_ENDS[0], DOT_ENDS[1]), Paint::fill(colour));
        }
        for receiver in &self.others {
            map.circle(plan.project(*receiver), 3.0, Paint::fill(WHITE).outlined(INK, 1.0));
        }
        self.selected.iter().for_each(|receiver| plan.draw_receiver(&mut map, *receiver));
        plan.draw_numbers(&mut map, &self.selected, TEXT, [8.0, 5.0]);
        plan.with_title(map, &self.title, &self.note((low, high)))
    }

    /// Explains the marks; `low` and `high` are the weakest and strongest power, dBm.
    fn note(&self, (low, high): (f64, f64)) -> String {
        let mut words = vec!["squares: selected receivers".to_owned()];
        if low <= high {
            let [low, high] = [low, high].map(|v| format!("{v:.0}").replace('-', "−"));
            words.push(format!("dots: transmitters, strongest power from {low} dBm (dark) to {high} dBm (light)"));
        }
        if !self.others.is_empty() {
            words.push("white circles: other receivers".into());
        }
        words.join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::canvas::outside;

    #[test]
    fn draws_empty_and_full_surveys() {
        let full = SurveyMap {
            title: "survey".into(),
            candidates: vec![[0.0, 0.0], [1.0, 2.0], [f64::NAN, 0.0]],
            known: vec![[0.5, 0.5]],
            selected: (0..12).map(|k| [f64::from(k) / 12.0, 1.0]).collect(),
            receivers: vec![[0.2, 0.1]],
        };
        for map in [SurveyMap::default(), full] {
            let svg = map.draw().svg("map", "");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert_eq!(svg.matches(">9<").count(), if map.selected.is_empty() { 0 } else { 3 });
            assert_eq!(outside::take().1, Vec::<String>::new(), "text leaves the map");
        }
    }

    #[test]
    fn draws_empty_and_full_maps() {
        let full = CoverageMap {
            title: "coverage".into(),
            transmitters: vec![[0.0, 0.0], [1.0, 2.0], [f64::NAN, 0.0], [0.4, 0.1]],
            powers: vec![-80.0, -60.0, -70.0, f64::NAN],
            selected: vec![[0.5, 0.5], [0.2, 1.0]],
            others: vec![[0.2, 0.1]],
        };
        for map in [CoverageMap::default(), full] {
            let svg = map.draw().svg("map", "");
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert_eq!(svg.contains("from −80 dBm"), !map.selected.is_empty());
            assert_eq!(outside::take().1, Vec::<String>::new(), "text leaves the map");
        }
    }
}

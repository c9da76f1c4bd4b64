//! Map of a survey: candidates, known measurements and selected positions.

use super::plan::FloorPlan;
use crate::canvas::{Anchor, BLACK, Canvas, Colour, INK, LINE, Paint, Point, TEXT, WHITE, wrapped};
use pwrfgs_core::colour::sequential;

/// Width of the drawing and maximum height of the map.
const WIDTH: f64 = 470.0;
const MOST_HEIGHT: f64 = 420.0;
/// Height for the title.
const HEAD: f64 = 22.0;
/// Size of the letters below the map.
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
    /// Draws the map. Colours run from dark (first position) to light (last position).
    pub fn draw(&self) -> Canvas {
        let framed = [&self.candidates, &self.known, &self.selected].into_iter().flatten().copied();
        let plan = FloorPlan::new(FloorPlan::corners(framed), ["x", "y"], WIDTH, MOST_HEIGHT);
        let mut map = plan.canvas();
        plan.points(&mut map, self.candidates.iter().copied());
        for place in &self.known {
            map.circle(plan.place(*place), 0.7 * RADIUS, Paint::stroke(KNOWN, 1.0));
        }
        let last = self.selected.len().saturating_sub(1).max(1) as f64;
        for (k, place) in self.selected.iter().enumerate().rev() {
            let [r, g, b] = sequential(k as f64 / last).map(u32::from);
            let fill = Paint::fill(Colour::hex(r << 16 | g << 8 | b));
            map.circle(plan.place(*place), RADIUS, fill.outlined(BLACK, 0.6));
        }
        self.receivers.iter().for_each(|place| plan.receiver(&mut map, *place));
        self.draw_numbers(&mut map, &plan);
        plan.axes(&mut map);
        let width = plan.size[0].max(300.0);
        let note = wrapped(&self.note(&plan), width * TEXT / SMALL);
        let mut canvas = Canvas::new(width, HEAD + plan.size[1] + LINE * (note.len() as f64 + 0.5));
        canvas.text([width / 2.0, 15.0], Anchor::Middle, &self.title);
        canvas.put([(width - plan.size[0]) / 2.0, HEAD], 1.0, &map);
        canvas.letters.size = SMALL;
        for (k, line) in note.iter().enumerate() {
            canvas.text([width / 2.0, HEAD + plan.size[1] + LINE * (k as f64 + 0.8)], Anchor::Middle, line);
        }
        canvas
    }

    /// Writes the numbers of the first selected positions.
    fn draw_numbers(&self, map: &mut Canvas, plan: &FloorPlan) {
        map.letters.size = SMALL;
        for (k, place) in self.selected.iter().take(NUMBERED).enumerate() {
            let ([x, y], words) = (plan.place(*place), (k + 1).to_string());
            for (colour, shift) in [(WHITE, 0.8), (WHITE, -0.8), (INK, 0.0)] {
                map.letters.colour = colour;
                map.text([x + 1.4 * RADIUS + shift, y - RADIUS + shift], Anchor::Start, &words);
            }
        }
        map.letters.colour = INK;
    }

    /// Explains the marks.
    fn note(&self, plan: &FloorPlan) -> String {
        let mut words = vec!["circles: selected positions, dark first".to_owned(), "grey dots: candidates".into()];
        if !self.known.is_empty() {
            words.push("grey circles: known measurements".into());
        }
        if self.receivers.iter().any(|place| plan.holds(*place)) {
            words.push("squares: receivers".into());
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
}

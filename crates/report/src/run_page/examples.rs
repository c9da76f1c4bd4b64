//! `Example`: best, median and worst prediction of a test link.

use crate::draw::spectra::{self, ColourScale, Mark};
use minijinja::{Value, context};
use pwrfgs_core::{Image, ImagePlane, Result};
use pwrfgs_experiment::{LoadedRun, scores::MODEL};

/// Test link with its prediction.
pub(super) struct Example {
    /// `Best`, `Median` or `Worst`.
    pub(super) which: &'static str,
    /// Index of the sample.
    pub(super) sample: usize,
    /// First metric of the task, such as SSIM.
    pub(super) score: f64,
    /// Distance to the nearest training transmitter, metres; `None` if there is none.
    pub(super) nearest_m: Option<f64>,
    /// Measurement.
    pub(super) truth: Image,
    /// Prediction, not clamped.
    pub(super) prediction: Image,
}

impl Example {
    /// Returns the facts of the link for the template: name, id, receiver, position and distance.
    pub(super) fn words(&self, run: &LoadedRun<'_>) -> Value {
        let sample = run.data.sample(self.sample);
        context! {
            which => self.which,
            id => sample.id,
            receiver => run.data.scene.receivers[sample.receiver].name.clone(),
            tx => run.data.placed.then(|| sample.position().map(|v| format!("{v:.2}")).join(", ")),
            nearest => self.nearest_m.map(|distance| format!("{distance:.2} m")),
        }
    }
}

/// Chooses the best, median and worst test link of a run by the first metric, without repetition; none without test samples.
/// They are predicted again, which gives identical bits.
///
/// # Errors
/// An observation that cannot be read.
pub(super) fn choose_examples(run: &LoadedRun<'_>) -> Result<Vec<Example>> {
    let (data, part, model) = (run.data, &run.partition.test, run.model.prepare());
    let headline = data.task().headline;
    let scores = if let Some(scores) = run.record.scores.sample_values(MODEL, headline.key) {
        scores.to_vec()
    } else {
        // The pipeline does not contain this metric.
        let mut scores = Vec::with_capacity(part.len());
        for_each_link(run, part, |_, truth, prediction| scores.push(data.task().score(prediction, truth)));
        scores
    };
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| headline.cost(scores[a]).total_cmp(&headline.cost(scores[b])).then(a.cmp(&b)));
    let Some(last) = order.len().checked_sub(1) else { return Ok(Vec::new()) };
    let mut chosen = vec![("Best", order[0]), ("Median", order[last / 2]), ("Worst", order[last])];
    chosen.dedup_by_key(|c| c.1);
    let example = |(which, i): (&'static str, usize)| {
        let (sample, score) = (part[i], scores[i]);
        let nearest = run.record.test.nearest_train_m.get(&data.label(sample)).copied();
        let nearest_m = nearest.filter(|distance| distance.is_finite());
        let prediction = model.predict_timed(data.query(sample)).0;
        Example { which, sample, score, nearest_m, truth: data.image(sample), prediction }
    };
    let examples = chosen.into_iter().map(example).collect();
    data.observations.check()?;
    Ok(examples)
}

/// Number of links that are predicted together.
const CHUNK: usize = 512;

/// Calls `visit` for each link with its measurement and prediction, in order.
pub(super) fn for_each_link(run: &LoadedRun<'_>, links: &[usize], mut visit: impl FnMut(usize, &Image, &Image)) {
    let (model, data) = (run.model.prepare(), run.data);
    for chunk in links.chunks(CHUNK) {
        let queries = data.queries(chunk);
        for (&i, predicted) in chunk.iter().zip(model.predict_many(&queries)) {
            visit(i, &data.image(i), &predicted);
        }
    }
}

/// Draws truth, prediction and error of the `chosen` spectra, none for other tasks. Also returns the common limit of the errors:
/// the largest, rounded up to a multiple of 0.1.
pub(super) fn spectra_panels(run: &LoadedRun<'_>, chosen: &[Example]) -> (Vec<Value>, f64) {
    let chosen = if run.data.task().has_pixels { chosen } else { &[] };
    let errors: Vec<Image> = chosen.iter().map(|e| image_difference(&e.prediction.clamped(), &e.truth)).collect();
    let largest = errors.iter().flat_map(|e| &e.pixels).fold(0.0, |m: f64, e| m.max(e.abs() as f64));
    let limit = ((largest * 10.0).ceil() / 10.0).max(0.1);
    let example = |(example, error): (&Example, &Image)| {
        let Example { score, truth, prediction, .. } = example;
        let marks = [Mark::Measured(truth.argmax()), Mark::Predicted(prediction.argmax())];
        let panel =
            |name, image: &Image, scale, marks: &[Mark]| draw_panel(run.model.plane(), name, image, scale, marks);
        context! {
            ssim => format!("{score:.3}"),
            peaks => describe_peaks(run, truth, prediction),
            panels => vec![
                panel("Ground truth", truth, ColourScale::Power, &marks[..1]),
                panel("Predicted", &prediction.clamped(), ColourScale::Power, &marks),
                panel("Predicted − truth", error, ColourScale::Error(limit), &[]),
            ],
            ..example.words(run)
        }
    };
    (chosen.iter().zip(&errors).map(example).collect(), limit)
}

/// Draws a spectrum as a map and, if the plane has angles, as a sky plot; returns them for the template.
fn draw_panel(plane: &ImagePlane, name: &str, image: &Image, scale: ColourScale, marks: &[Mark]) -> Value {
    let map = spectra::draw_map(image, plane, scale, marks).svg("map", name);
    let sky = spectra::draw_sky(image, plane, scale, marks).map(|canvas| canvas.svg("sky", name));
    context! { name, map, sky }
}

/// Returns the difference `a` minus `b`, pixel by pixel.
fn image_difference(a: &Image, b: &Image) -> Image {
    Image { width: a.width, height: a.height, pixels: a.pixels.iter().zip(&b.pixels).map(|(a, b)| a - b).collect() }
}

/// Describes the strongest true and predicted direction, azimuth and elevation in degrees; empty if the plane has no angles.
fn describe_peaks(run: &LoadedRun<'_>, truth: &Image, prediction: &Image) -> String {
    let plane = run.model.plane();
    let direction = |image: &Image| {
        let i = image.argmax();
        plane.azimuth_elevation_deg((i % image.width) as _, (i / image.width) as _)
    };
    match (direction(truth), direction(prediction)) {
        (Some((az, el)), Some((az2, el2))) => {
            format!("strongest at {az:.0}° / {el:.0}°, predicted {az2:.0}° / {el2:.0}°")
        }
        _ => String::new(),
    }
}

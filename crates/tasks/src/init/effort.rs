//! `Effort`: how long a proposed pipeline trains, and the settings that fit the number of positions.

use super::survey::{DataSurvey, longest_side};

/// Number of known positions below which a set is small: training is short, and several models share the noise.
pub(super) const SMALL: usize = 1_000;
/// Largest number of pixels of known spectra that the largest effort stores, in 100 MB; else residuals have a stride.
const STORED_PIXELS: usize = 25_000_000;

/// Training of a proposed pipeline: its time, and number of models.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Effort {
    /// One model: seconds for small sets.
    Fast,
    /// The default: up to two minutes on two cores for small sets.
    #[default]
    Normal,
    /// Few positions: twice as many models; for received powers also wider networks. Many positions: up to four models.
    Best,
}

impl Effort {
    /// Reads `fast`, `normal` or `best`.
    ///
    /// # Errors
    /// Another word; the message lists the three.
    pub fn parse(word: &str) -> Result<Self, String> {
        match word {
            "fast" => Ok(Self::Fast),
            "normal" => Ok(Self::Normal),
            "best" => Ok(Self::Best),
            _ => Err(format!("`{word}` is no effort; give fast, normal or best")),
        }
    }

    /// Returns the argument for this effort.
    fn pick<T>(self, fast: T, normal: T, best: T) -> T {
        match self {
            Self::Fast => fast,
            Self::Normal => normal,
            Self::Best => best,
        }
    }
}

/// Settings for the number of known positions and the effort, with their reasons.
pub(super) struct Sizing {
    /// Number of models.
    models: usize,
    /// Changes of the template.
    pub(super) set: Vec<String>,
    /// Number of models and steps in one sentence, then the reasons, one note each.
    pub(super) notes: Vec<String>,
}

impl Sizing {
    /// Chooses the settings for the data of a survey.
    pub(super) fn of(survey: &DataSurvey, effort: Effort) -> Self {
        let data = &survey.data;
        let has_residuals = data.features.is_none() && !data.scene.moving.is_receiver() && !data.task().is_complex;
        let mut sizing = if survey.known_positions() < SMALL && has_residuals {
            Self::small(survey, effort)
        } else {
            Self::large(survey, effort)
        };
        let has_held_out = sizing.models > 1 || survey.has_validation();
        sizing.set.push(format!("members={}", sizing.models));
        if has_residuals && has_held_out {
            let has_few_pixels = survey.known_links() * data.width * data.height <= STORED_PIXELS;
            // With stride 1 and a share of 0, the residual process equals the baseline Kriging bit for bit.
            let is_exact = data.task().has_pixels && effort == Effort::Best && has_few_pixels;
            sizing.set.push(format!("residuals=Kriged({})", if is_exact { "stride: 1" } else { "" }));
        }
        sizing
    }

    /// Chooses the settings for many positions: those of the template, with more or less time.
    fn large(survey: &DataSurvey, effort: Effort) -> Self {
        let mut set: Vec<String> = (effort == Effort::Fast).then(|| "training.scale=0.25".into()).into_iter().collect();
        if survey.data.task().is_scalar {
            // About one step per position, as in the template: 4,000 steps at 3,840 positions.
            set.push(format!("training.steps={}", survey.known_positions().clamp(1_200, 4_000)));
        }
        let models = effort.pick(1, 1, 4).min(survey.known_parts().max(1));
        let words = match effort {
            Effort::Fast => "one model, a quarter of the steps".to_owned(),
            _ if models == 1 => "one model".to_owned(),
            _ => format!("{models} models, {models} times as long"),
        };
        let notes = vec![format!("{words}; `pwrfgs check` measures the time.")];
        Self { models, set, notes }
    }

    /// Chooses the settings for few positions: several models, each without a part of the positions, and short training against
    /// overfitting. Steps, jitter, width and decay were chosen by held-out blocks of five training sets
    /// (docs/lab/init.md).
    fn small(survey: &DataSurvey, effort: Effort) -> Self {
        let (data, positions) = (&survey.data, survey.known_positions());
        let is_power = data.task().is_scalar;
        let (steps, most) = if is_power {
            ((4 * positions).clamp(400, 1_200), 32)
        } else {
            ((5 * positions / 2).clamp(600, 2_000), 16)
        };
        let batch = survey.batch_size(most);
        // Two of eight models leave out the same of four parts (`Pipeline::parts`), so the share of the residuals is chosen for
        // their mean. A step at many receivers takes about twice as long, so there are half as many models.
        let has_short_steps = is_power && !survey.is_link_limited(batch);
        let models = if has_short_steps { effort.pick(1, 8, 16) } else { effort.pick(1, 4, 8) };
        let parts = survey.known_parts().max(1);
        let models = if parts < 4 { models.min(parts) } else { models };
        let mut set = vec![
            "pruners=[]".into(),
            "training.densify_until=0".into(),
            "training.prune_until=0".into(),
            "training.target_count=0".into(),
            format!("training.steps={steps}"),
            format!("training.batch={batch}"),
        ];
        if is_power {
            set.push(format!("deformation.width={}", effort.pick(48, 48, 64)));
            set.push(format!("training.tx_jitter_m={:.3}", longest_side(data) / 40.0));
            let others = ["initializer.count=150", "deformation.depth=2", "training.optimizer.network_decay=1.0"];
            set.extend(others.map(str::to_owned));
        }
        let each = if models > 1 {
            format!("{models} models, each without a part of them, in")
        } else {
            "one model in".into()
        };
        let mut notes = vec![format!("{positions} known positions are few: {each} {steps} steps.")];
        let against_noise = "Shifted positions, a small network and weight decay keep models from learning noise.";
        notes.extend(is_power.then(|| against_noise.into()));
        notes.push(
            "Masks cannot close in so few steps, so training starts with as many Gaussians as it ends with. To prune: \
             `pruners: [LearnableMask()]`, with `steps: 4000` and `prune_until: 1000` in `training`."
                .into(),
        );
        Self { models, set, notes }
    }
}

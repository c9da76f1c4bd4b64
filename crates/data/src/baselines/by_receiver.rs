//! `ByReceiver`: a predictor a receiver, and one for those that nothing is known of.

use pwrfgs_core::words::clean;
use pwrfgs_core::{Dataset, Image, Known, Predict, Query, Result};

/// A predictor that learned from the links of one receiver.
pub(super) trait Fitted: Predict {
    /// What tables print under themselves of all receivers, with their names.
    fn notes(each: &[(&str, &Self)]) -> Option<String>;
}

/// One for each receiver of the data.
pub(super) struct ByReceiver<P> {
    /// With its name; `None` where the receiver has no link to learn from.
    each: Vec<(String, Option<P>)>,
    /// Learned from all links, for those that have none.
    pooled: Option<P>,
}

impl<P: Fitted> ByReceiver<P> {
    /// Fits the links of every receiver with `fit`; those of the only one as they are.
    pub(super) fn fit<'a>(
        data: &'a Dataset,
        known: Known<'_>,
        fit: impl Fn(Known<'_>) -> Result<P>,
    ) -> Result<Box<dyn Predict + 'a>>
    where
        P: 'a,
    {
        let receivers = &data.scene.receivers;
        let of_each = [known.train, known.validation].map(|links| of_receivers(data, links));
        let fit_one = |r: usize| {
            let own = Known { train: &of_each[0][r], validation: &of_each[1][r] };
            // Who has nothing at all to learn from is told so by the fit itself.
            let is_deaf = own.train.is_empty() && own.validation.is_empty() && receivers.len() > 1;
            Ok((clean(&receivers[r].name), if is_deaf { None } else { Some(fit(own)?) }))
        };
        let each = (0..receivers.len()).map(fit_one).collect::<Result<Vec<_>>>()?;
        let pooled = if each.iter().any(|(_, own)| own.is_none()) { Some(fit(known)?) } else { None };
        Ok(Box::new(Self { each, pooled }))
    }
}

/// The links of each receiver among these.
fn of_receivers(data: &Dataset, links: &[usize]) -> Vec<Vec<usize>> {
    let mut all = vec![Vec::new(); data.scene.receivers.len()];
    links.iter().for_each(|&i| all[data.links[i].receiver].push(i));
    all
}

impl<P: Fitted> Predict for ByReceiver<P> {
    fn predict(&self, query: Query<'_>) -> Image {
        let own = self.each.get(query.receiver).and_then(|(_, own)| own.as_ref());
        let any = || self.each.iter().find_map(|(_, own)| own.as_ref());
        own.or(self.pooled.as_ref()).or_else(any).expect("one predictor was fitted at least").predict(query)
    }

    fn note(&self) -> Option<String> {
        let own: Vec<(&str, &P)> =
            self.each.iter().filter_map(|(name, own)| Some((name.as_str(), own.as_ref()?))).collect();
        let deaf: Vec<&str> =
            self.each.iter().filter(|(_, own)| own.is_none()).map(|(name, _)| name.as_str()).collect();
        let pooled = (!deaf.is_empty())
            .then(|| format!("{} has no training link and is predicted from those of all receivers", deaf.join(", ")));
        let notes: Vec<String> = P::notes(&own).into_iter().chain(pooled).collect();
        (!notes.is_empty()).then(|| notes.join("; "))
    }
}

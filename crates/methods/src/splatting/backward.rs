//! Backward pass of the drawings of a step on the CPU: cotangents of several drawings in parallel, and sums in their order, so
//! that the bits do not depend on the number of threads.

use super::{BlendedSignals, ReceiverView, Splatting, received};
use crate::ActivationVjp;
use crate::groups::ReceiverGroup;
use pwrfgs_core::{Call, Deltas, MethodVjp, Primitives, Real, RenderVjp};
use rayon::prelude::*;

/// Links that share a geometry, with their drawing.
pub(super) type Drawing = (ReceiverGroup, ReceiverView, BlendedSignals);

/// Backward pass, given the cotangents of the observations.
pub(super) struct BackwardPass<'a> {
    pub(super) splatting: &'a Splatting,
    pub(super) call: &'a Call<'a>,
    /// Terms of the network.
    pub(super) deltas: &'a Deltas,
    /// Cotangents of the observations `[L, values]`.
    pub(super) d: &'a [Real],
}

/// Cotangents of a drawing.
struct DrawingVjp {
    /// Those of offset and path-loss exponent of the receiver; `None` for spectra.
    law: Option<[Real; 2]>,
    render: RenderVjp,
    primitives: Primitives,
}

impl BackwardPass<'_> {
    /// Adds the cotangents of cloud and terms to `grads`, and those of receivers, existence factors and ends of links to `sums`,
    /// with statistics.
    pub(super) fn add(&self, drawings: &[Drawing], grads: &mut ActivationVjp, sums: &mut MethodVjp) {
        let rows: Vec<usize> = (0..self.call.parameters.cloud.len()).collect();
        // Chunks limit the memory of cotangents; their size does not affect the sums.
        for chunk in drawings.chunks(2 * rayon::current_num_threads()) {
            let cotangents: Vec<_> = chunk.par_iter().map(|drawing| self.drawing_vjp(drawing)).collect();
            for (drawing, cotangents) in chunk.iter().zip(cotangents) {
                self.add_drawing(drawing, &cotangents, grads, sums);
                let (_, view, BlendedSignals { geometry, .. }) = drawing;
                sums.stats.add_render(&rows, &geometry.splats, &cotangents.render, &view.plane, drawings.len());
            }
        }
    }

    /// Computes the cotangents of a drawing.
    fn drawing_vjp(&self, (group, view, drawing): &Drawing) -> DrawingVjp {
        let Self { splatting, call, d, .. } = *self;
        let d = group.gather_rows(d, call.setup.value_count());
        let mut law = (splatting.law_parameter_count(call.setup) > 0).then_some([0.0; 2]);
        let d_blended = splatting.read_out_vjp(view, law.as_mut(), &group.distances(call), &drawing.render.pixels, &d);
        let (render, primitives) = splatting.draw_vjp(view, drawing, &call.parameters, &d_blended);
        DrawingVjp { law, render, primitives }
    }

    /// Adds the cotangents of a drawing to `grads` and `sums`, as [`Self::add`].
    fn add_drawing(
        &self,
        (group, view, drawing): &Drawing,
        DrawingVjp { law, render, primitives }: &DrawingVjp,
        grads: &mut ActivationVjp,
        sums: &mut MethodVjp,
    ) {
        let Self { splatting, call, deltas, d } = *self;
        let Call { setup, parameters: p, .. } = *call;
        let (receiver, activation) = (group.state.receiver, splatting.activation());
        let (network, laws) = splatting.split_weights(setup, p.weights);
        let d_laws = &mut sums.weights[network.len()..];
        let (d_offsets, d_exponents) = d_laws.split_at_mut(d_laws.len() / 2); // the order of `LAW`
        if let Some([d_offset, d_exponent]) = law {
            d_offsets[receiver] += d_offset;
            d_exponents[receiver] += d_exponent;
        }
        if let (Some([_, exponent]), Some(d_positions)) = (laws.receiver_law(receiver), &mut sums.positions) {
            let (distances, d) = (group.distances(call), group.gather_rows(d, setup.value_count()));
            let d_distances = distances.iter().zip(&*d).map(|(r, d)| d * received::distance_slope(exponent, *r));
            group.distances_vjp(call, d_distances, d_positions);
        }
        group.gather_terms_vjp(deltas, grads, |terms, batch, grads| {
            activation.geometry_vjp(p.cloud, terms, batch.start, p.gate, primitives, grads);
            activation.signals_vjp(p.cloud, terms, batch, &render.signals, grads);
        });
        sums.existence.iter_mut().zip(&render.splats.existence).for_each(|(sum, d)| *sum += d);
        if setup.moving.is_receiver() {
            let pose_vjp = || drawing.geometry.primitives.pose_vjp(&view.pose, primitives);
            group.add_pose_vjp(sums, pose_vjp);
        }
    }
}

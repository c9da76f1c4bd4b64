// Numbers per Gaussian of drawings, as in `draw.rs`, and the least opacity that is drawn, for drawing and for whole training
// steps.
const SPLAT: u32 = 12u;    // mean 2, conic 3, opacity, existence, half the sides of its box 2, radius
const ROW: u32 = 20u;      // derivatives: mean 3, log scales 3, rotation 4, logit, gate, terms 7; radius
const GEOMETRY: u32 = 8u;  // derivatives of a splat: mean 2, conic 3, opacity, weight, existence; signals follow
const ALPHA_MIN: f32 = 0.003921568859368563; // 1/255

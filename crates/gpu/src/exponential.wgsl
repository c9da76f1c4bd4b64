// Computes eˣ with the polynomial of the CPU: the built-in function may be off by 3 + 2|x| units in the last place.
fn exponential(value: f32) -> f32 {
  let x = clamp(value, -87.0, 88.0);
  let n = floor(x * 1.4426950408889634 + 0.5);
  let r = fma(n, 2.1219444e-4, fma(n, -0.6933594, x));
  var p = fma(r, 0.0013889, 0.00836338);
  p = fma(p, r, 0.04166573); p = fma(p, r, 0.16666655); p = fma(p, r, 0.5); p = fma(p, r, 1.0); p = fma(p, r, 1.0);
  return p * bitcast<f32>(u32(i32(n) + 127) << 23u);
}

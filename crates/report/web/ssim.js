/**
 * Structural similarity of two images [height, width] with values from 0 to 1, as in the scores: uniform windows of 7 x 7
 * pixels inside the image, sample covariance. Small images use the largest odd window that fits.
 */
export function structuralSimilarity(a, b, width, height) {
  const window = [7, 5, 3, 1].find((side) => side <= Math.min(width, height));
  if (!window) return 1;
  const columns = new Float64Array(5 * width);
  let total = 0;
  for (let y = 0; y < height; y++) {
    addSsimRow(columns, a, b, width, y, 1);
    if (y >= window) addSsimRow(columns, a, b, width, y - window, -1);
    if (y + 1 >= window) total += ssimOfRow(columns, width, window);
  }
  return total / ((width - window + 1) * (height - window + 1));
}

/** Adds `sign` times x, y, x², y² and xy of one row to the sums of each column. */
function addSsimRow(columns, a, b, width, y, sign) {
  for (let i = 0, k = y * width; i < width; i++, k++) {
    const p = clampGrey(a[k]);
    const q = b[k];
    columns[i] += sign * p;
    columns[width + i] += sign * q;
    columns[2 * width + i] += sign * p * p;
    columns[3 * width + i] += sign * q * q;
    columns[4 * width + i] += sign * p * q;
  }
}

/** Sum over all windows of one row. */
function ssimOfRow(columns, width, window) {
  const n = window * window;
  const sums = [0, 0, 0, 0, 0];
  let total = 0;
  for (let i = 0; i < width; i++) {
    for (let k = 0; k < 5; k++) {
      sums[k] += columns[k * width + i] - (i >= window ? columns[k * width + i - window] : 0);
    }
    if (i + 1 >= window) total += ssimOfWindow(sums, n);
  }
  return total;
}

function ssimOfWindow(sums, n) {
  const [x, y, xx, yy, xy] = sums.map((sum) => sum / n);
  const sample = n > 1 ? n / (n - 1) : 1;
  const [vx, vy, cov] = [(xx - x * x) * sample, (yy - y * y) * sample, (xy - x * y) * sample];
  const [c1, c2] = [1e-4, 9e-4];
  return ((2 * x * y + c1) * (2 * cov + c2)) / ((x * x + y * y + c1) * (vx + vy + c2));
}

/** Clamps a grey value as metrics and images do. */
export function clampGrey(value) {
  return value < 0 ? 0 : value > 1 ? 1 : value;
}

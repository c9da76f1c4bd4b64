//! Each kernel against sums in double precision; choice of the GPU; memory that does not suffice.

use crate::adapters::{GpuLine, KERNELS, adapters, pick};
use crate::draw::Drawing;
use crate::shaders::{DRAWING, DRAWING_SOURCE, NETWORKS_SOURCE, RESIDENT, RESIDENT_SOURCE};
use crate::{Block, Epilogue, Gpu, SLICE, for_tests, scratch_len};
use pwrfgs_core::device::DeviceChoice;
use pwrfgs_core::{Real, rng};

const ROWS: [usize; 8] = [0, 1, 63, 64, 65, 157, 1000, 2500];

fn random(name: &str, len: usize) -> Vec<Real> {
    let mut random = rng::stream(3, name, len as u64);
    (0..len).map(|_| rng::normal(&mut random)).collect()
}

/// Runs a step over slots with these values; returns the last slot, twice, to compare bits.
fn run(gpu: &Gpu, slots: &[&[Real]], scratch: usize, pass: impl Fn(&mut crate::GpuStep<'_>)) -> Vec<Real> {
    let sizes: Vec<usize> = std::iter::once(scratch).chain(slots.iter().map(|values| values.len())).collect();
    let once = || {
        let mut step = gpu.step(&sizes).unwrap();
        (1..).zip(slots).for_each(|(slot, values)| step.upload(slot, 0, values));
        pass(&mut step);
        step.read(slots.len(), 0, slots[slots.len() - 1].len());
        step.finish().unwrap().remove(0)
    };
    let (first, second) = (once(), once());
    assert!(first.iter().map(|x| x.to_bits()).eq(second.iter().map(|x| x.to_bits())), "equal bits");
    first
}

/// Compares with sums in double precision, relative to the largest.
fn compare(name: &str, found: &[Real], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    let largest = expected.iter().fold(1.0, |most: f64, x| most.max(x.abs()));
    for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((f64::from(*found) - expected).abs() <= 1e-6 * largest, "{name}, {i}: {found}, not {expected}");
    }
}

#[test]
fn products_with_every_epilogue_match_sums() {
    let Some(gpu) = for_tests() else { return };
    for rows in ROWS {
        for (m, k, transposed) in [(9, 33, false), (70, 20, true), (65, 130, false), (2, 3, true)] {
            // An offset and a longer stride, as for some columns of a layer.
            let a = random("a", 5 + m * (k + 2));
            let b = random("b", k * rows);
            let [bias, other, c] =
                [("h", m + 3), ("e", m * rows), ("c", m * rows)].map(|(name, len)| random(name, len));
            let block = if transposed {
                Block { slot: 1, start: 5, strides: (1, m) }
            } else {
                Block { slot: 1, start: 5, strides: (k + 2, 1) }
            };
            let sum = |i: usize, j: usize| -> f64 {
                let one =
                    |l: usize| f64::from(a[5 + i * block.strides.0 + l * block.strides.1]) * f64::from(b[l * rows + j]);
                (0..k).map(one).sum()
            };
            let element = |f: &dyn Fn(usize, f64) -> f64| -> Vec<f64> {
                (0..m * rows).map(|at| f(at, sum(at / rows, at % rows))).collect()
            };
            let [h, e, before] = [&bias, &other, &c].map(|values| |i: usize| f64::from(values[i]));
            let masked = |at: usize, v: f64| if e(at) > 0.0 { v } else { 0.0 };
            let cases: [(Epilogue, Vec<f64>); 5] = [
                (Epilogue::default(), element(&|_, v| v)),
                (
                    Epilogue { bias: Some((3, 3)), relu: true, ..Epilogue::default() },
                    element(&|at, v| (v + h(3 + at / rows)).max(0.0)),
                ),
                (
                    Epilogue { bias: Some((3, 0)), plus: Some(4), relu: true, ..Epilogue::default() },
                    element(&|at, v| (v + e(at) + h(at / rows)).max(0.0)),
                ),
                (Epilogue { mask: Some(4), ..Epilogue::default() }, element(&masked)),
                (Epilogue { add: true, ..Epilogue::default() }, element(&|at, v| before(at) + v)),
            ];
            for (epilogue, expected) in cases {
                let slots = [&a[..], &b, &bias, &other, &c];
                let found = run(gpu, &slots, 1, |step| {
                    step.product((m, rows, k), block, Block::new(2, 0, rows), Block::new(5, 0, rows), epilogue);
                });
                compare(&format!("{rows} rows, {epilogue:?}"), &found, &expected);
            }
        }
    }
}

#[test]
fn gradients_and_row_sums_match_sums() {
    let Some(gpu) = for_tests() else { return };
    for rows in ROWS {
        let (m, n) = (66, 9);
        let (a, b) = (random("a", m * rows), random("b", n * rows));
        // Into some columns of a wider matrix.
        let (stride, start) = (n + 4, 2);
        let c = random("c", start + m * stride);
        let found = run(gpu, &[&a, &b, &c], scratch_len(rows, m * n), |step| {
            let into = Block { slot: 3, start, strides: (stride, 1) };
            step.add_gradient((m, n), rows, Block::new(1, 0, rows), Block::new(2, 0, rows).t(), into);
        });
        let mut expected: Vec<f64> = c.iter().map(|&c| f64::from(c)).collect();
        for i in 0..m {
            for j in 0..n {
                let one = |r: usize| f64::from(a[i * rows + r]) * f64::from(b[j * rows + r]);
                expected[start + i * stride + j] += (0..rows).map(one).sum::<f64>();
            }
        }
        compare(&format!("gradient over {rows}"), &found, &expected);

        let c = random("sums", m + 2);
        let sums = run(gpu, &[&a, &c], scratch_len(rows, m), |step| step.add_row_sums((m, rows), (1, 0), (2, 1)));
        let mut expected: Vec<f64> = c.iter().map(|&c| f64::from(c)).collect();
        (0..m).for_each(|i| expected[1 + i] += a[i * rows..(i + 1) * rows].iter().map(|&a| f64::from(a)).sum::<f64>());
        compare(&format!("row sums of {rows}"), &sums, &expected);
    }
    assert_eq!(scratch_len(SLICE + 1, 3), 6);
}

#[test]
fn passes_over_elements_match_the_cpu() {
    let Some(gpu) = for_tests() else { return };
    let zeros = |len: usize| vec![0.0; len];
    for rows in ROWS {
        let (a, h, c) = (random("a", 3 * rows), random("h", 5), random("c", 3 * rows));
        let found = run(gpu, &[&a, &h, &zeros(3 * rows)], 1, |step| step.bias_relu((3, rows), 1, (2, 1), 3));
        let expected: Vec<f64> = (0..3 * rows).map(|i| f64::from((a[i] + h[1 + i / rows]).max(0.0))).collect();
        compare("bias and ReLU", &found, &expected);
        let found = run(gpu, &[&a, &c], 1, |step| step.add(3 * rows, 1, 2));
        compare("add", &found, &(0..3 * rows).map(|i| f64::from(a[i] + c[i])).collect::<Vec<_>>());

        let (mut s, t, d) = (random("s", rows), random("t", rows), random("d", rows));
        s.iter_mut().step_by(7).for_each(|s| *s = 0.0); // the slope at 0 is 0
        let found = run(gpu, &[&s, &t, &d, &c], 1, |step| step.amplitudes_vjp(rows, [1, 2, 3, 4]));
        let amplitude = |z: Real| if z < 0.0 { -0.01 * f64::from(z) } else { f64::from(z) };
        let slope = |z: Real| {
            if z > 0.0 {
                1.0
            } else if z < 0.0 {
                -0.01
            } else {
                0.0
            }
        };
        let expected: Vec<f64> = (0..3 * rows)
            .map(|at| {
                let (i, before) = (at % rows, f64::from(c[at]));
                let d = f64::from(d[i]);
                match at / rows {
                    0 => d * amplitude(t[i]) * slope(s[i]),
                    1 => before + d * amplitude(s[i]) * slope(t[i]),
                    _ => before + d * amplitude(s[i]) * amplitude(t[i]),
                }
            })
            .collect();
        compare("amplitudes", &found, &expected);

        let frequencies = 3;
        let x: Vec<f64> = random("x", 3 * rows).into_iter().map(f64::from).collect();
        let mut gamma: Vec<Real> = x.iter().map(|&x| x as Real).collect();
        for f in 0..frequencies {
            let scale = f64::from(1 << f);
            gamma.extend(x.iter().map(|x| (scale * x).sin() as Real));
            gamma.extend(x.iter().map(|x| (scale * x).cos() as Real));
        }
        let d = random("d", gamma.len());
        let found = run(gpu, &[&gamma, &d, &c], 1, |step| step.encode_vjp((frequencies, rows), [1, 2, 3]));
        let expected: Vec<f64> = (0..3 * rows)
            .map(|i| {
                let wave = |f: usize| {
                    let (scale, at) = (f64::from(1 << f), (3 + 6 * f) * rows + i);
                    let (sine, cosine) = (scale * x[i]).sin_cos();
                    scale * (cosine * f64::from(d[at]) - sine * f64::from(d[at + 3 * rows]))
                };
                f64::from(c[i]) + f64::from(d[i]) + (0..frequencies).map(wave).sum::<f64>()
            })
            .collect();
        compare("octaves", &found, &expected);
    }
}

#[test]
fn nan_passes_the_relu() {
    let Some(gpu) = for_tests() else { return };
    let mut step = gpu.step(&[1, 2, 1, 2]).unwrap();
    step.upload(1, 0, &[Real::NAN, -1.0]);
    step.upload(2, 0, &[0.0]);
    step.bias_relu((1, 2), 1, (2, 0), 3);
    step.read(3, 0, 2);
    let found = step.finish().unwrap().remove(0);
    assert!(found[0].is_nan() && found[1] == 0.0);
}

#[test]
fn shaders_are_valid_and_use_no_atomics() {
    let modules = [(NETWORKS_SOURCE, &KERNELS[..]), (DRAWING_SOURCE, &DRAWING), (RESIDENT_SOURCE, &RESIDENT)];
    for (source, kernels) in modules {
        let module = naga::front::wgsl::parse_str(source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(source)));
        let (flags, capabilities) = (naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
        naga::valid::Validator::new(flags, capabilities).validate(&module).unwrap();
        let names: Vec<&str> = module.entry_points.iter().map(|entry| entry.name.as_str()).collect();
        assert_eq!(names, kernels);
        assert!(!source.contains("atomic<") && !source.contains("subgroup"));
    }
}

#[test]
fn a_step_knows_what_the_last_one_left() {
    let Some(gpu) = for_tests() else { return };
    let number = gpu.step(&[1, 1, 8]).unwrap().number();
    // Other tests run steps too.
    let step = gpu.step(&[1, 1, 8]).unwrap();
    assert_eq!(step.follows(number), step.number() == number + 1);
    assert!(!step.follows(step.number()));
}

#[test]
fn memory_beyond_the_gpu_is_an_error_before_the_step() {
    let Some(gpu) = for_tests() else { return };
    let error = gpu.step(&[gpu.most_bytes as usize / 4 + 1]).unwrap_err().to_string();
    let words = ["--device: a step needs ", " of GPU memory, ", " in one buffer", gpu.name(), "use a smaller `width`"];
    assert!(words.iter().all(|word| error.contains(word)), "{error}");
    // Buffers that fit one by one, but not together.
    let mut small = Gpu::open(&adapters()[0]).unwrap();
    small.memory = 3 << 20;
    let error = small.step(&[1 << 18; 4]).unwrap_err().to_string();
    let words = ["--device: a step needs 4 MB of GPU memory, and ", " has 3 MB; use a smaller `width`"];
    assert!(words.iter().all(|word| error.contains(word)), "{error}");
    assert!(small.step(&[1 << 18; 3]).unwrap().finish().unwrap().is_empty(), "usable afterwards");
}

#[test]
fn drawings_beyond_the_gpu_are_errors_before_the_step() {
    let Some(gpu) = for_tests() else { return };
    let error = gpu.drawing_step(&[gpu.most_bytes as usize / 4 + 1]).unwrap_err().to_string();
    assert!(error.contains("; use a smaller `training.batch`, fewer Gaussians, or the CPU"), "{error}");
    assert_eq!(Drawing::entry_count(&[1e7, 5.0]).unwrap(), 10_000_005);
    let error = Drawing::entry_count(&[1e7, 1e7]).unwrap_err().to_string();
    assert!(error.contains("--device: tile lists with 20000000 entries, at most 16777216; use fewer"), "{error}");
}

#[test]
fn memory_that_runs_out_within_a_step_is_an_error() {
    let Some(gpu) = for_tests() else { return };
    let error = gpu.create_buffer(1 << 62, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST).unwrap_err();
    assert!(!error.is_empty());
    // An error in the midst of a step is that of its end.
    let gpu = &Gpu::open(&adapters()[0]).unwrap();
    let mut step = gpu.step(&[1, 4]).unwrap();
    step.read(1, 4, 4); // beyond the buffer
    let error = step.finish().unwrap_err();
    assert!(matches!(error, pwrfgs_core::Error::Device(_)), "{error}");
    // Results of a step that are larger than any buffer.
    let mut step = gpu.step(&[1, 1 << 22]).unwrap();
    let reads = gpu.device.limits().max_buffer_size >> 24;
    (0..=reads).for_each(|_| step.read(1, 0, 1 << 22));
    let error = step.finish().unwrap_err();
    assert!(matches!(error, pwrfgs_core::Error::Device(_)) && error.to_string().contains(gpu.name()), "{error}");
    let mut step = gpu.step(&[1, 4]).unwrap();
    step.read(1, 0, 4);
    assert_eq!(step.finish().unwrap()[0].len(), 4, "usable afterwards");
}

#[test]
fn kept_buffers_outlive_steps() {
    let Some(gpu) = for_tests() else { return };
    let kept = gpu.create_kept_buffer(3).unwrap();
    let mut step = gpu.step(&[1, 4]).unwrap();
    step.upload(1, 0, &[1.0, 2.0, 3.0, 4.0]);
    step.save(1, 3, &kept);
    step.clear(1, 4);
    step.finish().unwrap();
    let mut step = gpu.step(&[1, 4]).unwrap();
    step.clear(1, 4); // a step of another test may have written since
    step.load(1, 3, &kept);
    step.read(1, 0, 4);
    assert_eq!(step.finish().unwrap(), [[1.0, 2.0, 3.0, 0.0]]);
    assert!(gpu.create_kept_buffer(gpu.most_bytes as usize).is_none());
}

#[test]
fn choice_of_the_gpu_is_explained() {
    let gpu = |name: &str, is_software| GpuLine { name: name.to_owned(), is_software };
    let (card, llvmpipe) =
        (gpu("NVIDIA H100 (Vulkan, 580.159)", false), gpu("llvmpipe (LLVM 15) (Vulkan, Mesa)", true));
    let both = [card, llvmpipe.clone()];
    let soft = [llvmpipe];
    assert_eq!(pick(DeviceChoice::Gpu, &both, false), Ok(Some(0)));
    assert_eq!(pick(DeviceChoice::Auto, &both, false), Ok(Some(0)));
    assert_eq!(pick(DeviceChoice::Auto, &soft, false), Ok(None));
    assert_eq!(pick(DeviceChoice::Auto, &[], false), Ok(None));
    assert_eq!(pick(DeviceChoice::Cpu, &both, false), Ok(None));
    assert_eq!(pick(DeviceChoice::Gpu, &soft, true), Ok(Some(0)));
    assert_eq!(pick(DeviceChoice::Number(1), &both, true), Ok(Some(1)));
    for (choice, lines, words) in [
        (
            DeviceChoice::Gpu,
            &[][..],
            "no GPU found (Vulkan, Metal, DX12); install a driver, on a cluster set VK_DRIVER_FILES, or leave --device out",
        ),
        (DeviceChoice::Gpu, &soft, "only llvmpipe, a software GPU slower than the CPU, was found"),
        (DeviceChoice::Number(1), &both, "is a software GPU slower than the CPU; see `pwrfgs devices`"),
        (DeviceChoice::Number(2), &both, "GPUs 0 to 1 were found; see `pwrfgs devices`"),
        (DeviceChoice::Number(1), &soft, "one GPU, number 0, was found"),
        (DeviceChoice::Number(0), &[], "no GPU was found"),
    ] {
        let why = pick(choice, lines, false).unwrap_err();
        assert!(why.contains(words), "{choice}: {why}");
    }
}

use super::*;
use std::fs;

/// Creates two spectra of 3 x 2, counted from `first`, as bytes of each format.
fn kinds() -> [(Number, Vec<u8>); 4] {
    let values = || (0..12u8).map(|v| f64::from(v) / 16.0);
    [
        (Number::U8, (0..12).collect()),
        (Number::U16, (0..12u16).flat_map(|v| (1000 * v).to_le_bytes()).collect()),
        (Number::F32, values().flat_map(|v| (v as f32).to_le_bytes()).collect()),
        (Number::F64, values().flat_map(f64::to_le_bytes).collect()),
    ]
}

#[test]
fn file_and_memory_give_equal_values() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("spectra");
    for (number, bytes) in kinds() {
        fs::write(&path, [b"head".as_slice(), &bytes].concat()).unwrap();
        let memory = Spectra::in_memory((3, 2), number, bytes).unwrap();
        let file = Spectra::open(&path, 4, number, [2, 2, 3]).unwrap();
        assert!(memory.bytes_in_memory() == 12 * number.bytes() && file.bytes_in_memory() == 0);
        let copied = file.clone().into_memory().unwrap();
        fs::remove_file(&path).unwrap(); // an open file outlives its name
        for spectra in [&file, &copied] {
            assert_eq!((spectra.len(), spectra.width(), spectra.height()), (2, 3, 2));
            for i in 0..2 {
                assert_eq!(spectra.image(i), memory.image(i), "{number:?}");
                let sums = [&memory, spectra].map(|s| {
                    let mut sum = [1.0; 6];
                    s.add(i, 0.5, &mut sum);
                    sum
                });
                assert_eq!(sums[0], sums[1]);
                let last = memory.image(i).pixels[5] as f64 * number.full_scale();
                assert!((sums[0][5] - (1.0 + 0.5 * last)).abs() < 1e-3);
            }
            spectra.check().unwrap();
        }
    }
}

#[test]
fn grey_values_are_multiples_of_one_255th() {
    let spectra = Spectra::grey((3, 2), (0..12).collect()).unwrap();
    assert_eq!(spectra.image(1), Image::from_bytes(3, 2, &[6, 7, 8, 9, 10, 11]));
    let full = Spectra::in_memory((1, 1), Number::U16, vec![255, 255]).unwrap();
    assert_eq!(full.image(0).pixels, [1.0]);
}

#[test]
fn coarse_image_has_every_second_row_and_column() {
    for (number, bytes) in kinds() {
        let spectra = Spectra::in_memory((3, 4), number, bytes).unwrap();
        let all = spectra.image(0).pixels;
        let mut coarse = [0.0; 4];
        spectra.sampled(0, Sampling::every(2), &mut coarse);
        assert_eq!(coarse, [all[0], all[2], all[6], all[8]]);
        let sampling = Sampling { offset: [1, 1], ..Sampling::every(2) };
        let mut shifted = [0.0; 2];
        spectra.sampled(0, sampling, &mut shifted);
        assert_eq!(shifted, [all[4], all[10]]);
        let mut at = [0.0];
        spectra.sampled_at(0, sampling, &[1], &mut at);
        assert_eq!(at, [all[10]]);
        let mut same = [0.0; 12];
        spectra.sampled(0, Sampling::WHOLE, &mut same);
        assert_eq!(same.as_slice(), all);
    }
}

#[test]
fn rejects_files_that_are_not_spectra() {
    for (size, count) in [((3, 2), 0), ((3, 2), 7), ((0, 2), 6), ((usize::MAX, 2), 6)] {
        assert!(Spectra::grey(size, vec![0; count]).is_err());
    }
    let mut values = [0.5; 12];
    values[10] = f32::NAN;
    let message = Spectra::float((3, 2), &values).unwrap_err();
    assert_eq!(message.to_string(), "spectra[1, 1, 1] is NaN; give numbers from 0 to 1");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("spectra");
    fs::write(&path, [0; 12]).unwrap();
    for shape in [[3, 2, 3], [1, 2, 3], [0, 2, 3], [usize::MAX; 3]] {
        let message = Spectra::open(&path, 0, Number::U8, shape).unwrap_err();
        assert!(message.is_input() && message.to_string().contains("do not fit its 12 bytes"), "{message}");
    }
    assert!(Spectra::open(&folder.path().join("none"), 0, Number::U8, [2, 2, 3]).unwrap_err().is_input());
}

#[test]
fn reports_file_truncated_during_reading() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("spectra");
    fs::write(&path, [7; 12]).unwrap();
    let spectra = Spectra::open(&path, 0, Number::U8, [2, 2, 3]).unwrap();
    fs::File::options().write(true).open(&path).unwrap().set_len(9).unwrap();
    assert_eq!(spectra.raw(0)[0], 7);
    spectra.check().unwrap();
    assert_eq!(spectra.raw(1).as_ref(), [0; 6]);
    let message = spectra.check().unwrap_err().to_string();
    assert!(message.contains("file of spectra was changed or removed while open"), "{message}");
}

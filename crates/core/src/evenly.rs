//! `evenly`: a few of many, the same ones every time.

/// At most `count` of `all`, evenly spread.
pub fn evenly<T: Clone>(all: &[T], count: usize) -> Vec<T> {
    let n = all.len().min(count);
    (0..n).map(|i| all[i * all.len() / n].clone()).collect()
}

#[cfg(test)]
mod tests {
    use super::evenly;

    #[test]
    fn samples_are_chosen_evenly() {
        let part: Vec<usize> = (100..110).collect();
        assert_eq!(evenly(&part, 3), [100, 103, 106]);
        assert_eq!(evenly(&part, 50), part);
        assert!(evenly(&part, 0).is_empty() && evenly::<usize>(&[], 5).is_empty());
    }
}

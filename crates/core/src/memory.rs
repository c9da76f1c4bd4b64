//! One limit on the memory that a reader or a computation holds, which is compared with its need before the work.

use crate::files;
use std::path::Path;

/// Maximum memory of one reader or computation, bytes: 16 GiB.
const MOST: u64 = 1 << 34;

/// Returns the memory that one reader or computation may hold, bytes: what the system has available, at most 16 GiB.
pub fn memory_limit() -> u64 {
    let text = files::read_at_most(Path::new("/proc/meminfo"), 1 << 16).unwrap_or_default(); // missing on other systems
    available_in(&String::from_utf8_lossy(&text)).map_or(MOST, |bytes| bytes.min(MOST))
}

/// Returns the available memory in the text of `/proc/meminfo`, bytes.
fn available_in(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.trim().strip_suffix(" kB")?.parse::<u64>().ok().map(|kilobytes| kilobytes << 10)
}

/// Rejects work that holds more than [`memory_limit`].
///
/// # Errors
/// The message states both amounts and the next step, which is `advice`; its subject is the file or the work.
pub fn check_memory(bytes: u64, advice: &str) -> Result<(), String> {
    let limit = memory_limit();
    if bytes <= limit {
        return Ok(());
    }
    let [needed, limit] = [bytes, limit].map(|bytes| bytes as f64 / 1e9);
    Err(format!("needs {needed:.1} GB of memory, more than the {limit:.1} GB that are available; {advice}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_available_memory_of_system() {
        let text = "MemTotal:       24641680 kB\nMemFree:  11 kB\nMemAvailable:   20123456 kB\n";
        assert_eq!(available_in(text), Some(20_123_456 << 10));
        assert_eq!((available_in(""), available_in("MemAvailable: lots")), (None, None));
        assert!((1..=MOST).contains(&memory_limit()));
    }

    #[test]
    fn rejects_work_beyond_limit_with_both_amounts() {
        assert_eq!(check_memory(1 << 10, ""), Ok(()));
        let fault = check_memory(1 << 60, "give fewer channels").unwrap_err();
        assert!(fault.starts_with("needs 1152921504.6 GB of memory, more than the "), "{fault}");
        assert!(fault.ends_with(" GB that are available; give fewer channels"), "{fault}");
    }
}

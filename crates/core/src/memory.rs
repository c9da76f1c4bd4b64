//! One limit on the memory that a reader or a computation holds, which is compared with its need before the work.

/// Maximum memory of one reader or computation, bytes: 16 GiB.
const MAX_BYTES: u64 = 1 << 34;

/// Amount that is accepted without asking the system, bytes: 64 MiB.
const UNCHECKED_BYTES: u64 = 1 << 26;

/// Returns the memory that one reader or computation may hold, bytes: [`free_memory`], at most 16 GiB; 16 GiB if it is
/// unavailable.
fn memory_limit() -> u64 {
    free_memory().map_or(MAX_BYTES, |bytes| bytes.min(MAX_BYTES))
}

/// Rejects work that holds more than [`free_memory`] or 16 GiB. Work of up to 64 MiB is always accepted.
///
/// # Errors
/// The message begins with `needs`: the caller names the file or the work. It states both amounts and the next step, which is
/// `advice`.
pub fn check_memory(bytes: u64, advice: &str) -> Result<(), String> {
    if bytes <= UNCHECKED_BYTES {
        return Ok(());
    }
    let limit = memory_limit();
    if bytes <= limit {
        return Ok(());
    }
    let [needed, limit] = [bytes, limit].map(|bytes| bytes as f64 / 1e9);
    Err(format!("needs {needed:.1} GB of memory, more than the {limit:.1} GB that are available; {advice}"))
}

/// Returns the largest resident memory of this process, bytes; 0 if unavailable.
pub fn peak_memory() -> u64 {
    let status = system_text("/proc/self/status").unwrap_or_default();
    memory_entry(&status, "VmHWM:").unwrap_or(0)
}

/// Returns the memory available to this process, bytes: the minimum of free memory, the limit of the control group (a
/// job of Slurm, a container) and `ulimit -v`; `None` if unavailable.
pub fn free_memory() -> Option<u64> {
    let machine = memory_entry(&system_text("/proc/meminfo").unwrap_or_default(), "MemAvailable:");
    [machine, free_control_group_memory(), free_address_space()].into_iter().flatten().min()
}

/// Returns the bytes that follow `name` in a `text` of lines such as `VmHWM:  1234 kB`; `None` without such a line or
/// amount.
fn memory_entry(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// Returns the remaining memory of the control group, bytes; `None` without a limit, or without control groups of version 2.
fn free_control_group_memory() -> Option<u64> {
    let groups = system_text("/proc/self/cgroup")?;
    let path = groups.lines().find_map(|line| line.strip_prefix("0::"))?.trim();
    let number = |file: &str| system_text(&format!("/sys/fs/cgroup{path}/{file}"))?.trim().parse::<u64>().ok();
    Some(number("memory.max")?.saturating_sub(number("memory.current")?))
}

/// Returns the remaining address space of `ulimit -v`, bytes; `None` without a limit.
fn free_address_space() -> Option<u64> {
    let limits = system_text("/proc/self/limits")?;
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    let limit = line.split_whitespace().next()?.parse::<u64>().ok()?;
    let used = memory_entry(&system_text("/proc/self/status")?, "VmSize:")?;
    Some(limit.saturating_sub(used))
}

/// Returns the text of a file of the system; `None` if it cannot be read.
#[allow(clippy::disallowed_methods)] // files of the system never block
fn system_text(path: &str) -> Option<String> {
    std::fs::read_to_string(path).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_available_memory_of_system() {
        let text = "MemTotal:       24641680 kB\nMemFree:  11 kB\nMemAvailable:   20123456 kB\n";
        assert_eq!(memory_entry(text, "MemAvailable:"), Some(20_123_456 << 10));
        assert_eq!(memory_entry("VmRSS:\t  12 kB\nVmHWM:\t    7 kB\n", "VmHWM:"), Some(7 * 1024));
        assert_eq!(memory_entry("VmHWM: unlimited\n", "VmHWM:"), None);
        assert!((1_000_000..=MAX_BYTES).contains(&memory_limit()));
        if cfg!(target_os = "linux") {
            assert!(peak_memory() > 1_000_000 && free_memory().is_some_and(|bytes| bytes > 1_000_000));
        }
    }

    #[test]
    fn rejects_work_beyond_limit_with_both_amounts() {
        assert_eq!(check_memory(1 << 10, ""), Ok(()));
        let fault = check_memory(1 << 60, "give fewer channels").unwrap_err();
        assert!(fault.starts_with("needs 1152921504.6 GB of memory, more than the "), "{fault}");
        assert!(fault.ends_with(" GB that are available; give fewer channels"), "{fault}");
    }
}

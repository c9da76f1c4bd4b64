//! Memory: what this process has used, and what is left for it.

use pwrfgs_core::files::read_string as read_to_string;

/// Largest resident memory of this process, bytes; 0 where the system does not tell.
pub(crate) fn peak() -> u64 {
    let status = read_to_string("/proc/self/status").unwrap_or_default();
    kib(&status, "VmHWM:").unwrap_or(0)
}

/// Bytes that this process can still take: what the machine has free, the control group allows (a job of Slurm, a
/// container) and `ulimit -v` leaves, whichever is least; `None` where the system does not tell.
pub(crate) fn free() -> Option<u64> {
    let machine = kib(&read_to_string("/proc/meminfo").unwrap_or_default(), "MemAvailable:");
    [machine, control_group(), address_space()].into_iter().flatten().min()
}

/// The number behind `name` in a file of lines such as `VmHWM:  1234 kB`.
fn kib(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

/// What is left of the limit of the control group (version 2), where there is one.
fn control_group() -> Option<u64> {
    let own = read_to_string("/proc/self/cgroup").ok()?;
    let path = own.lines().find_map(|line| line.strip_prefix("0::"))?.trim();
    let number = |file: &str| read_to_string(format!("/sys/fs/cgroup{path}/{file}")).ok()?.trim().parse::<u64>().ok();
    Some(number("memory.max")?.saturating_sub(number("memory.current")?))
}

/// What is left of `ulimit -v`, where it is set.
fn address_space() -> Option<u64> {
    let limits = read_to_string("/proc/self/limits").ok()?;
    let line = limits.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    let limit = line.split_whitespace().next()?.parse::<u64>().ok()?;
    let used = kib(&read_to_string("/proc/self/status").ok()?, "VmSize:")?;
    Some(limit.saturating_sub(used))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linux_tells() {
        if cfg!(target_os = "linux") {
            assert!(peak() > 1_000_000 && free().is_some_and(|bytes| bytes > 1_000_000));
        }
        assert_eq!(kib("VmRSS:\t  12 kB\nVmHWM:\t    7 kB\n", "VmHWM:"), Some(7 * 1024));
        assert_eq!(kib("VmHWM: unlimited\n", "VmHWM:"), None);
    }
}

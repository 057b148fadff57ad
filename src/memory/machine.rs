//! The machine's memory limits, and the memory of this process.

use std::fs;

/// Budget if no limit is known.
const FALLBACK: u64 = 2 << 30;

/// Half of the memory that this process may use: the smallest of the machine's memory, the limit of its cgroup, and the limit of
/// its address space.
pub fn default_budget() -> u64 {
    let sources = [machine_bytes(), cgroup_bytes(), address_space_bytes()];
    sources.into_iter().flatten().min().map_or(FALLBACK, |bytes| bytes / 2)
}

fn machine_bytes() -> Option<u64> {
    kib_line(&fs::read_to_string("/proc/meminfo").ok()?, "MemTotal:")
}

/// Resident bytes of this process, where the system reports them.
pub fn resident_bytes() -> Option<u64> {
    kib_line(&fs::read_to_string("/proc/self/status").ok()?, "VmRSS:")
}

/// The bytes in a line such as `MemTotal:  1024 kB`.
fn kib_line(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

/// The limit of the address space (`ulimit -v`).
fn address_space_bytes() -> Option<u64> {
    address_space(&fs::read_to_string("/proc/self/limits").ok()?)
}

/// Reads the soft limit of the address space from `/proc/self/limits`.
fn address_space(text: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix("Max address space"))?;
    line.split_ascii_whitespace().next()?.parse().ok()
}

/// The smallest limit of the cgroups of this process, version 2 or 1.
fn cgroup_bytes() -> Option<u64> {
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    limit_files(&groups)
        .iter()
        .filter_map(|file| fs::read_to_string(file).ok()?.trim().parse().ok())
        .min()
}

/// Files that may hold a limit, for every group in `/proc/self/cgroup` and its ancestors.
fn limit_files(groups: &str) -> Vec<String> {
    let mut files = Vec::new();
    for line in groups.lines() {
        let mut parts = line.splitn(3, ':').skip(1);
        let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { continue };
        let (mount, name) = if controllers.is_empty() {
            ("/sys/fs/cgroup", "memory.max")
        } else if controllers.split(',').any(|controller| controller == "memory") {
            ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")
        } else {
            continue;
        };
        let mut path = path.trim_end_matches('/');
        loop {
            files.push(format!("{mount}{path}/{name}"));
            match path.rfind('/') {
                Some(end) => path = &path[..end],
                None => break,
            }
        }
    }
    files
}

/// Size from which an allocation gets its own mapping. It is larger than anything that a frame of 1024 × 1024 allocates at once.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
const MAPPED_BYTES: libc::c_int = 6 << 20;

/// Sets up the allocator; to be called before threads are started. With a fixed threshold, large allocations go back to the
/// system when they are freed. By default glibc adapts and keeps blocks of up to 32 MiB, and small blocks in use then pin the
/// memory of removed scenes. If the address space is limited, there are only two arenas: glibc reserves 64 MiB of addresses for
/// each, and makes up to eight per core.
pub fn set_up_allocator() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[allow(unsafe_code, reason = "mallopt has no safe wrapper")]
    // SAFETY: mallopt takes two numbers, and is called before any thread but this one is started.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, MAPPED_BYTES);
        if address_space_bytes().is_some() {
            libc::mallopt(libc::M_ARENA_MAX, 2);
        }
    }
}

/// Returns freed memory to the system. glibc keeps freed blocks in its arenas below blocks that are in use, which can be most of
/// a deleted scene.
pub fn release_unused() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[allow(unsafe_code, reason = "malloc_trim has no safe wrapper")]
    // SAFETY: malloc_trim takes no pointer, and may be called from any thread at any time.
    unsafe {
        libc::malloc_trim(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_read_as_the_system_writes_them() {
        assert_eq!(
            kib_line("MemTotal:       24567 kB\nMemFree: 1 kB", "MemTotal:"),
            Some(25156608)
        );
        assert_eq!(kib_line("MemTotal: many", "MemTotal:"), None);
        let limits = "Limit  Soft Limit  Hard Limit  Units\nMax address space  2147483648  unlimited  bytes\n";
        assert_eq!(address_space(limits), Some(2 << 30));
        assert_eq!(address_space("Max address space  unlimited  unlimited  bytes"), None);
    }

    #[test]
    fn limits_are_looked_for_in_every_group_above() {
        let v2 = limit_files("0::/user.slice/a.scope\n");
        assert_eq!(
            v2,
            [
                "/sys/fs/cgroup/user.slice/a.scope/memory.max",
                "/sys/fs/cgroup/user.slice/memory.max",
                "/sys/fs/cgroup/memory.max",
            ]
        );
        let v1 = limit_files("5:cpu:/x\n4:memory:/docker/1\n0::/\n");
        assert_eq!(
            v1,
            [
                "/sys/fs/cgroup/memory/docker/1/memory.limit_in_bytes",
                "/sys/fs/cgroup/memory/docker/memory.limit_in_bytes",
                "/sys/fs/cgroup/memory/memory.limit_in_bytes",
                "/sys/fs/cgroup/memory.max",
            ]
        );
    }

    #[test]
    fn there_is_a_default() {
        assert!(default_budget() > 16 << 20);
    }
}

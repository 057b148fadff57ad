//! The cache in which commands keep point trees between runs.

use std::path::PathBuf;

use anyhow::ensure;

use crate::bake::cache::BakeCache;
use crate::bake::external::Memory;

const DEFAULT_MAX_MIB: u64 = 4096;

/// Settings of the cache; `None` marks a setting that was not given.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct CacheArgs {
    /// Cache folder for point trees [default: `pointillist` in the user's cache folder]
    #[arg(long, env = "POINTILLIST_CACHE", value_name = "FOLDER")]
    pub cache: Option<PathBuf>,
    /// Do not use the point tree cache, even if --cache is given
    #[arg(long, env = "POINTILLIST_NO_CACHE", num_args = 0..=1, default_missing_value = "true", require_equals = true)]
    pub no_cache: Option<bool>,
    /// Maximum size of the cache folder, in MiB; the least recently used trees are deleted first [default: 4096]
    #[arg(long, env = "POINTILLIST_CACHE_MAX_MIB", value_name = "MIB")]
    pub cache_max_mib: Option<u64>,
    /// Memory limit for building point trees, in MiB; larger builds use temporary files in the cache folder [default: half of the free memory]
    #[arg(long, env = "POINTILLIST_BAKE_MEMORY_MIB", value_name = "MIB")]
    pub bake_memory_mib: Option<u64>,
}

/// Lower bound of `--bake-memory-mib`.
const LEAST_BAKE_MIB: u64 = Memory::LEAST >> 20;

impl CacheArgs {
    /// The requested cache; `None` if it is not wanted, or if no folder is given and the user has no folder for caches. Does not
    /// access the disk.
    ///
    /// # Errors
    /// `--cache-max-mib` or `--bake-memory-mib` is too small.
    pub fn open(&self) -> anyhow::Result<Option<BakeCache>> {
        let mib = self.cache_max_mib.unwrap_or(DEFAULT_MAX_MIB);
        ensure!(mib >= 1, "--cache-max-mib {mib}: must be at least 1");
        let memory = self.bake_memory_mib.unwrap_or(LEAST_BAKE_MIB);
        ensure!(
            memory >= LEAST_BAKE_MIB,
            "--bake-memory-mib {memory}: must be at least {LEAST_BAKE_MIB}"
        );
        if self.no_cache == Some(true) {
            return Ok(None);
        }
        let folder = self.cache.clone().or_else(BakeCache::default_folder);
        let bake_bytes = self.bake_memory_mib.map(|mib| mib.saturating_mul(1 << 20));
        let cache = |folder| {
            BakeCache::new(folder, mib.saturating_mul(1 << 20)).with_bake_bytes(bake_bytes)
        };
        Ok(folder.map(cache))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: CacheArgs,
    }

    fn opened(line: &[&str]) -> anyhow::Result<Option<BakeCache>> {
        Line::parse_from(std::iter::once(&"bake").chain(line)).args.open()
    }

    #[test]
    fn what_is_asked_for_is_opened() {
        let cache = opened(&["--cache", "/c", "--cache-max-mib", "3"]).unwrap().unwrap();
        assert_eq!((cache.folder().to_str(), cache.max_bytes()), (Some("/c"), 3 << 20));
        let cache = opened(&["--cache", "/c", "--no-cache=false"]).unwrap().unwrap();
        assert_eq!(cache.max_bytes(), 4 << 30);
        assert!(opened(&["--cache", "/c", "--no-cache"]).unwrap().is_none());
        let cache = opened(&["--cache", "/c", "--bake-memory-mib", "100"]).unwrap().unwrap();
        assert_eq!(cache.bake_bytes(), Some(100 << 20));
        let refused = opened(&["--bake-memory-mib=63"]).unwrap_err().to_string();
        assert!(refused.contains("64"), "{refused}");
        let refused = opened(&["--cache-max-mib=0"]).unwrap_err().to_string();
        assert!(refused.contains("--cache-max-mib"), "{refused}");
    }
}

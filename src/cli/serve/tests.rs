use super::*;
use clap::Parser;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: Given,
}

fn given(line: &[&str]) -> Given {
    Line::parse_from(std::iter::once(&"serve").chain(line)).args
}

pub(super) fn flags(line: &[&str]) -> ServeArgs {
    given(line).over(ServeArgs::default()).unwrap()
}

#[test]
fn flags_win_over_the_file() {
    let file = parse_file(
        "queue = 7\nmax-batch = 3\nscene = [\"a.json\"]\ninsecure = true\nlog-format = \"json\"",
    );
    let given = given(&["--queue", "9", "--scene", "b.ply", "--scene", "c.ply"]);
    let args = given.over(file.unwrap()).unwrap();
    assert_eq!((args.queue, args.max_batch, args.insecure), (Some(9), Some(3), Some(true)));
    assert_eq!(args.scene, [PathBuf::from("b.ply"), PathBuf::from("c.ply")]);
    assert_eq!(args.log_format, Some(LogFormat::Json));
    assert_eq!(flags(&["--insecure"]).insecure, Some(true));
}

/// Tries every flag as a key of the file, and fails if serde does not know the flag by its name.
#[test]
fn every_flag_is_a_key_of_the_file() {
    for name in setting_names() {
        let values = ["1", "\"1\"", "[\"1\"]", "true", "\"json\"", "\"z\""];
        let taken = values.iter().any(|value| parse_file(&format!("{name} = {value}")).is_ok());
        assert!(taken, "{name}");
    }
}

#[test]
fn unknown_keys_are_suggested() {
    let error = parse_file("max-bach = 3").unwrap_err().to_string();
    assert!(error.contains("`max-batch`"), "{error}");
    assert!(parse_file("queue = \"many\"").unwrap_err().to_string().contains("queue"));
    assert!(parse_file("config = \"x\"").is_err());
}

#[test]
fn other_addresses_need_keys() {
    let open: SocketAddr = "0.0.0.0:80".parse().unwrap();
    let local: SocketAddr = "[::1]:80".parse().unwrap();
    assert!(access(&ServeArgs::default(), local).is_ok());
    assert!(access(&ServeArgs::default(), open).unwrap_err().to_string().contains("--api-keys"));
    let only_loopback = |args: &ServeArgs, address| match access(args, address) {
        Ok(Access::Open { only_loopback, .. }) => Some(only_loopback),
        _ => None,
    };
    assert_eq!(only_loopback(&ServeArgs::default(), local), Some(true));
    assert_eq!(only_loopback(&flags(&["--insecure"]), local), Some(false));
    assert_eq!(only_loopback(&flags(&["--insecure"]), open), Some(false));
    let folder = tempfile::tempdir().unwrap();
    let keys = folder.path().join("keys");
    std::fs::write(&keys, format!("a read {}\n", "0".repeat(64))).unwrap();
    let args = ServeArgs { api_keys: Some(keys.clone()), ..ServeArgs::default() };
    assert!(matches!(access(&args, open), Ok(Access::Keys(_))));
    std::fs::write(&keys, "a read 12\n").unwrap();
    assert!(access(&args, open).unwrap_err().to_string().contains("line 1"));
}

#[test]
fn numbers_below_their_least_are_refused() {
    let refused = |line: &[&str]| {
        let args = flags(line);
        let root = PathBuf::from("/");
        let access = Access::Open { cors_origins: Vec::new(), only_loopback: true };
        engine_config(&args, root.clone()).is_err()
            || settings(&args, root, access).is_err()
            || jobs_config(&args).is_err()
    };
    assert!(!refused(&[]));
    for flag in [
        "--queue=0",
        "--queue-seconds=0",
        "--queue-seconds=1e30",
        "--job-share=0",
        "--job-share=0.6",
        "--job-share=NaN",
        "--max-batch=0",
        "--gpu-budget-mib=0",
        "--host-memory-mib=0",
        "--cache-max-mib=0",
        "--max-upload-mib=0",
        "--max-uploads=0",
        "--max-uploads-per-key=0",
        "--upload-disk-mib=0",
        "--upload-disk-mib-per-key=0",
        "--max-streams-per-client=0",
        "--stream-idle-seconds=0",
        "--cors-origin=x",
        "--job-queue=0",
        "--job-runners=0",
        "--job-runners=65",
        "--job-disk-mib=0",
        "--job-ttl-seconds=0",
        "--max-watchers-per-client=0",
        "--watch-seconds=0",
        "--trusted-proxies=proxy",
        "--requests-per-second-per-address=0",
        "--requests-per-second-per-address=NaN",
        "--max-connections-per-address=0",
        "--tls-cert=/nonexistent",
        "--tls-key=/nonexistent",
        "--access-log=/nonexistent/file",
        "--audit-log=/nonexistent/file",
    ] {
        assert!(refused(&[flag]), "{flag}");
    }
}

/// systemd may kill a server whose frame takes longer than half of the watchdog's period.
#[test]
fn the_watchdog_outwaits_the_frame_timeout() {
    let unit = include_str!("../../../deploy/pointillist.service");
    let period_s = |line: &str| line.strip_prefix("WatchdogSec=")?.parse::<u64>().ok();
    let period = Duration::from_secs(unit.lines().find_map(period_s).unwrap());
    let access = Access::Open { cors_origins: Vec::new(), only_loopback: true };
    let settings = settings(&ServeArgs::default(), PathBuf::from("/"), access).unwrap();
    assert!(period / 2 >= settings.frame_timeout, "{period:?}");
}

/// The settings that a reload puts in force are those that the limits are made of, and the page lists them.
#[test]
fn a_reload_changes_what_the_limits_are_made_of() {
    use super::edge::{RELOADED, bounds};

    let shown =
        |file: &str| bounds(&parse_file(file).ok()?).ok().map(|bounds| format!("{bounds:?}"));
    let default = shown("").unwrap();
    let page = include_str!("../../../docs/deploy.md");
    for name in setting_names() {
        let values = ["7", "\"7\"", "[\"10.0.0.0/8\"]", "true", "\"json\"", "\"z\""];
        let texts: Vec<String> =
            values.iter().filter_map(|value| shown(&format!("{name} = {value}"))).collect();
        let is_bound = texts.iter().any(|text| *text != default);
        assert_eq!(is_bound, RELOADED.contains(&&name[..]), "{name}");
        assert!(!is_bound || page.contains(&format!("`{name}`")), "docs/deploy.md lacks {name}");
    }
}

use super::*;
use clap::Parser;

#[derive(Parser)]
struct Line {
    #[command(flatten)]
    args: LoadArgs,
}

fn parsed(line: &[&str]) -> Result<LoadArgs, String> {
    Line::try_parse_from(["load", "http://127.0.0.1:1"].iter().chain(line))
        .map(|line| line.args)
        .map_err(|error| error.to_string())
}

#[test]
fn rates_are_given_or_searched() {
    let rates = |line: &[&str]| parsed(line).unwrap().settings().unwrap().rates;
    assert_eq!(rates(&[]), Rates::Given(vec![10.0]));
    assert_eq!(rates(&["--rate", "2.5"]), Rates::Given(vec![2.5]));
    assert_eq!(rates(&["--rates", "10,20,5"]), Rates::Given(vec![10.0, 20.0, 5.0]));
    let Rates::Saturate(search) = rates(&["--saturate", "--first-rate", "3"]) else { panic!() };
    assert_eq!((search.first_per_s, search.factor), (3.0, 2.0));
    for line in [
        ["--rate", "0"].as_slice(),
        &["--rate", "nan"],
        &["--rates", "1,x"],
        &["--rate", "1", "--saturate"],
        &["--rates", "1", "--saturate"],
        &["--first-rate", "3"],
        &["--duration", "0"],
        &["--connections", "0"],
        &["--param", "w"],
        &["--streams", "-1"],
        &["--streams", "2", "--pose-rate", "0"],
        &["--pose-rate", "30"],
    ] {
        assert!(parsed(line).is_err(), "{line:?}");
    }
    let crossed = parsed(&["--saturate", "--first-rate", "9", "--max-rate", "8"]).unwrap();
    assert!(crossed.settings().is_err());
}

#[test]
fn settings_of_frames_are_passed_on() {
    let args = parsed(&[
        "--size",
        "64x48",
        "--lod",
        "spt",
        "--max-error-px",
        "2",
        "--reconstruct",
        "splats",
        "--param",
        "deadline_ms=90",
    ]);
    let query = args.unwrap().frame.query();
    let shown: Vec<String> = query.iter().map(|(name, value)| format!("{name}={value}")).collect();
    assert_eq!(
        shown.join("&"),
        "w=64&h=48&format=jpeg&lod=spt&max_error_px=2&reconstruct=splats&deadline_ms=90"
    );
}

//! The tables of the four papers with our figures beside them. Times of hardware of 2002 to 2008 and ours say little beside each other; their
//! ratios do.

use serde_json::Value;

use super::Found;
use super::page::Section;
use crate::common::report::number;

fn shown(value: Option<f64>) -> String {
    value.map_or("—".to_owned(), number)
}

fn scientific(value: Option<f64>) -> String {
    value.map_or("—".to_owned(), |value| format!("{value:.1e}"))
}

fn ratio(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    Some(a? / b?)
}

fn row(name: &str, cells: impl IntoIterator<Item = String>) -> Vec<String> {
    std::iter::once(name.to_owned()).chain(cells).collect()
}

pub fn coconu(found: &Found) -> Section {
    let mut section = Section::new("Coconu & Hege 2002: painted splats");
    let Some(bench) = found.bench("painted") else {
        return missing(section, "painted");
    };
    section.text(
        "L. Coconu, H.-C. Hege, Hardware-Accelerated Point-Based Rendering of Complex Scenes; Radeon 8500, 2.0 GHz Pentium 4. Ratios compare the \
         painted splats of a model with its full detail on the same machine.",
    );
    let paper = [
        ("Harley, 50 K triangles", 122.0, 55.0, 6.8, 20.0),
        ("Pisa, 350 K", 24.0, 23.1, 5.2, 27.0),
        ("Lobus, 1 M", 8.3, 16.7, 5.6, 33.0),
        ("tree, 250 K", 51.0, 44.9, 9.0, 30.0),
    ];
    let mut rows: Vec<Vec<String>> = paper
        .into_iter()
        .map(|(name, triangles, splats, rate, order)| {
            let cells = [triangles, splats, splats / triangles, rate, order].map(number);
            row(&format!("paper: {name}"), cells)
        })
        .collect();
    for model in ["relief", "tree", "statue"] {
        let value = |way: &str, what: &str| bench.value(&format!("{model}, {way}, {what}"));
        let (full, painted) = (value("full detail", "GPU ms"), value("painted", "GPU ms"));
        let per_second = |time: Option<f64>| time.map(|time| 1000.0 / time);
        let cells = [
            per_second(full),
            per_second(painted),
            ratio(full, painted),
            value("painted", "M nodes/s"),
            value("painted", "order %"),
        ];
        rows.push(row(&format!("ours: {model}"), cells.map(shown)));
    }
    section.table(
        "Table 3: models at 640 × 480 and splat size 2",
        &[
            "model",
            "full detail, frames/s",
            "splats, frames/s",
            "splats over full detail",
            "M splats/s",
            "order, % of the time",
        ],
        rows,
    );
    section.tables_of(&bench.0, "Grids");
    let paper = [11.6, 1.8];
    let ours = ["10 × 10", "200 × 200"]
        .map(|side| bench.value(&format!("{side}, painted at 3 px, frames/s")));
    section.table(
        "Table 4: what 400 times the triangles cost, splat size 3",
        &["", "10 × 10, frames/s", "200 × 200, frames/s", "ratio"],
        vec![
            row("paper", [paper[0], paper[1], paper[0] / paper[1]].map(number)),
            row("ours", [shown(ours[0]), shown(ours[1]), shown(ratio(ours[0], ours[1]))]),
        ],
    );
    if let Some(lod) = found.bench("lod") {
        let rate = lod.value("trees on 2 threads, M samples/s");
        section.table(
            "Table 1: samples a second into levels of detail (in the paper from triangles, by rasterising them)",
            &["", "K samples/s"],
            vec![
                row("paper: Harley, 135 K samples in 5 s", [number(27.0)]),
                row("paper: Lobus, 230 K in 80 s", [number(2.88)]),
                row("ours: a statue, two threads", [shown(rate.map(|rate| 1000.0 * rate))]),
            ],
        );
    }
    section.text("Left out: Table 2 (memory of layouts of 2002), and square splats without a Gaussian, which the program does not have.");
    section
}

pub fn zwicker(found: &Found) -> Section {
    let mut section = Section::new("Zwicker et al. 2004: perspective accurate splatting");
    section.text(
        "M. Zwicker, J. Räsänen, M. Botsch, C. Dachsbacher, M. Pauly, Perspective Accurate Splatting; GeForce FX 5950, 3 GHz Pentium 4.",
    );
    match found.bench("splats") {
        None => section.text("The bench splats has no results."),
        Some(bench) => {
            let line = |name: &str, of: [Option<f64>; 4]| {
                let more = [ratio(of[0], of[1]), ratio(of[2], of[3]), ratio(of[1], of[3])];
                row(name, of.into_iter().chain(more).map(shown))
            };
            let mut rows = vec![
                line("paper, Cg", [2.9, 1.4, 2.8, 1.2].map(Some)),
                line("paper, assembler", [11.2, 3.1, 10.4, 2.8].map(Some)),
            ];
            for filter in ["affine", "perspective", "exact"] {
                let of = [
                    "512 × 512, 1 pass",
                    "512 × 512, 3 passes",
                    "1280 × 1024, 1 pass",
                    "1280 × 1024, 3 passes",
                ]
                .map(|what| bench.value(&format!("{filter}, {what}, M splats/s")));
                rows.push(line(&format!("ours, {filter}"), of));
            }
            section.table(
                "Table 1: million splats a second, statues of 100 to 650 thousand samples",
                &[
                    "",
                    "512², 1 pass",
                    "512², 3 passes",
                    "1280 × 1024, 1 pass",
                    "1280 × 1024, 3 passes",
                    "1 pass over 3, 512²",
                    "1 pass over 3, 1280 × 1024",
                    "512² over 1280 × 1024, 3 passes",
                ],
                rows,
            );
        }
    }
    let entries = &found.checkerboard["scopes"][0]["entries"];
    let mut rows = Vec::new();
    for (name, label) in [
        ("affine filter", "splats full filter=affine"),
        ("perspective filter", "splats full"),
        ("exact filter", "splats full filter=exact"),
        ("perspective filter, without the prefilter", "splats full prefilter=false"),
    ] {
        let Some(entry) = entries.as_array().into_iter().flatten().find(|e| e["row"] == label)
        else {
            continue;
        };
        let of = |value: &Value| value.as_f64();
        rows.push(row(
            name,
            [
                of(&entry["psnr_db"]),
                of(&entry["ssim"]),
                of(&entry["flip"]),
                of(&entry["coverage"]["holes"]),
                of(&entry["gpu_ms"]["median"]),
            ]
            .map(shown),
        ));
    }
    if !rows.is_empty() {
        section.table(
            "Figures 6 and 7: a checkerboard at a flat angle, against 16 times the pixels (the paper shows pictures alone)",
            &["", "PSNR, dB", "SSIM", "FLIP", "hole pixels", "GPU, ms"],
            rows,
        );
    }
    let classes = found.stability["rows"].as_array().into_iter().flatten();
    let rows: Vec<Vec<String>> = classes
        .map(|class| {
            let of = |value: &Value| value.as_f64();
            let wrong = sum_of(&class["paper"], &["over_half_px", "not_finite"]);
            row(
                class["class"].as_str().unwrap_or_default(),
                [
                    shown(of(&class["regular"])),
                    scientific(of(&class["ours_outline"]["worst_px"])),
                    scientific(of(&class["ours_outline"]["bound_px"])),
                    shown(wrong),
                ],
            )
        })
        .collect();
    if !rows.is_empty() {
        section.table(
            "§4.3: outlines of splats in f32 against f64; the paper inverts a matrix, and discards splats for which that fails",
            &["splats", "number", "ours, worst, px", "bound, px", "the paper's inverse: over half a pixel off or not finite"],
            rows,
        );
    }
    section.text("Left out: Table 2 (instructions of shader programs of 2004).");
    section
}

/// Sum of some counts of an object; `None` where it has none of them.
fn sum_of(object: &Value, names: &[&str]) -> Option<f64> {
    let counts: Vec<f64> = names.iter().filter_map(|name| object[*name].as_f64()).collect();
    (!counts.is_empty()).then(|| counts.iter().sum())
}

pub fn dachsbacher(found: &Found) -> Section {
    let mut section = Section::new("Dachsbacher et al. 2003: sequential point trees");
    let Some(bench) = found.bench("lod") else { return missing(section, "lod") };
    section.text(
        "C. Dachsbacher, C. Vogelgsang, M. Stamminger, Sequential Point Trees; Radeon 9700, 2.4 GHz Pentium 4. Ours: a statue of a million samples at \
         1024², an accepted error of one pixel, at distances of 1 to 64 times the whole view's.",
    );
    let factors = [1, 2, 4, 8, 16, 32, 64];
    let at = |how: &str, factor: i32, what: &str| {
        bench.value(&format!("distance × {factor}, {how}, {what}"))
    };
    let ends = |values: Vec<f64>| {
        let (low, high) = values
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(*v), high.max(*v)));
        if low > high {
            return "—".to_owned();
        }
        format!("{} to {}", number(low), number(high))
    };
    let all = |how: &str, what: &str| factors.iter().filter_map(|f| at(how, *f, what)).collect();
    let rate = |how: &str, what: &str| {
        let best = factors
            .iter()
            .filter_map(|f| Some(at(how, *f, what)? / at(how, *f, "GPU ms")? / 1000.0))
            .fold(f64::NAN, f64::max);
        number(best)
    };
    let line = |name: &str, paper: &str, of: &dyn Fn(&str) -> String| {
        row(name, [paper.to_owned(), of("points"), of("splats")])
    };
    section.table(
        "§7: rates and loads",
        &["", "paper", "ours, points", "ours, splats"],
        vec![
            line("points drawn, M/s, at best", "50 to 60", &|how| rate(how, "accepted")),
            line("points processed, M/s, at best", "77 to 85", &|how| rate(how, "tested")),
            line("processed and not drawn, %", "10 to 40", &|how| {
                ends(all(how, "tested but not drawn, %"))
            }),
            line("CPU time over the frame's, %", "5 to 15", &|how| {
                ends(all(how, "CPU over GPU time, %"))
            }),
        ],
    );
    let rows = factors.iter().map(|factor| {
        let of = |how, what| at(how, *factor, what);
        row(
            &format!("× {factor}"),
            [
                of("points", "accepted"),
                of("points", "GPU ms"),
                of("splats", "accepted"),
                of("splats", "GPU ms"),
            ]
            .map(shown),
        )
    });
    section.table(
        "Fig. 1: a model that moves away (the paper shows pictures and loads of its own model)",
        &["distance", "points drawn", "GPU, ms", "splats drawn", "GPU, ms"],
        rows.collect(),
    );
    section.tables_of(&bench.0, "CPU time of the render thread");
    section.text("—: the program drew full detail, which tests no nodes, because that is faster.");
    section.text("Left out: the frame rates of Fig. 8, whose scene is not public.");
    section
}

pub fn marroquim(found: &Found) -> Section {
    let mut section = Section::new("Marroquim et al. 2008: pull-push");
    section.text(
        "R. Marroquim, M. Kraus, P. R. Cavalcanti, Efficient image reconstruction for point-based and line-based rendering; GeForce 8800 GTS, 1024². \
         The paper's point: pull and push take as long for any number of points.",
    );
    if let Some(bench) = found.bench("pull_push") {
        let paper = [
            ("Armadillo", 173_000, [22.0, 1.5, 18.0]),
            ("dragon", 437_000, [23.0, 2.9, 18.0]),
            ("Happy Buddha", 544_000, [24.0, 3.4, 18.0]),
            ("Asian Dragon", 3_610_000, [45.0, 25.0, 17.0]),
            ("Thai statue", 5_000_000, [55.0, 34.0, 18.0]),
        ];
        let line = |name: String,
                    points: u64,
                    [frame, project, pyramid]: [Option<f64>; 3],
                    first: Option<f64>| {
            let rate = frame.map(|frame| points as f64 / frame / 1000.0);
            let cells = [Some(points as f64), frame, project, pyramid, ratio(pyramid, first), rate];
            row(&name, cells.map(shown))
        };
        let mut rows: Vec<Vec<String>> = paper
            .iter()
            .map(|(name, points, of)| {
                line(format!("paper: {name}"), *points, of.map(Some), Some(18.0))
            })
            .collect();
        let sizes = [173_000, 437_000, 871_000, 2_000_000, 5_000_000u64];
        let of = |points: u64| {
            ["frame", "projection", "pull and push"]
                .map(|what| bench.value(&format!("lit colours, {points} samples, {what} ms")))
        };
        let first = of(sizes[0])[2];
        rows.extend(
            sizes.map(|points| line("ours: a statue".to_owned(), points, of(points), first)),
        );
        section.table(
            "Table 1, with colours",
            &[
                "model",
                "points",
                "frame, ms",
                "projection, ms",
                "pull and push, ms",
                "pull and push over the smallest's",
                "M points/s",
            ],
            rows,
        );
    }
    if let Some(bench) = found.bench("trees") {
        let mut rows = vec![
            row(
                "paper: one tree",
                [number(1000.0 / 28.0), number(1000.0 / 31.0), number(31.0 / 28.0)],
            ),
            row(
                "paper: ten trees",
                [number(1000.0 / 9.0), number(1000.0 / 15.0), number(15.0 / 9.0)],
            ),
        ];
        for place in ["near", "whole grove", "far"] {
            let value = |what: &str| bench.value(&format!("points, {place}: {what}"));
            let cells = [value("triangles ms"), value("lines ms"), value("triangles over lines")];
            rows.push(row(&format!("ours: ten trees, {place}"), cells.map(shown)));
        }
        section.table(
            "Figures 13 and 19: trees as triangles and as lines",
            &["", "triangles, ms", "lines, ms", "triangles over lines"],
            rows,
        );
    }
    section.text("Left out: the columns of Table 1 without colours, which `cargo bench --bench pull_push` prints.");
    section
}

fn missing(mut section: Section, bench: &str) -> Section {
    section.text(format!("The bench {bench} has no results."));
    section
}

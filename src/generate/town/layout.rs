//! Fills the plan with houses, trees, cars and other objects.

use glam::{DVec2, DVec3};

use super::builder::{Builder, Frame};
use super::ground::{Block, KERB_M, PAVEMENT_M, Plan, STREET_M, Use};
use super::house::House;
use crate::generate::numeric::sin_cos;
use crate::scene::random::SplitMix64;

/// Builds everything on the plan.
pub fn build(plan: &Plan, seed: u64) -> Builder {
    let mut builder = Builder::default();
    for (index, block) in plan.blocks.iter().enumerate() {
        let mut random = SplitMix64::stream(seed, 100 + index as u64);
        match block.usage {
            Use::Terrace => terrace(&mut builder, block, &mut random),
            Use::Villas => villas(&mut builder, block, &mut random),
            Use::Square => square(&mut builder, block, &mut random),
            Use::Park => park(&mut builder, block, &mut random),
        }
        kerbside(&mut builder, block, &mut random);
    }
    let mut random = SplitMix64::stream(seed, 99);
    parked_cars(&mut builder, plan, &mut random);
    builder
}

/// The sides of a block: for each a frame whose x runs along the kerb with the block to its left, and its length.
fn sides(block: &Block) -> [(Frame, f64); 4] {
    let (a, b) = (block.min, block.max);
    let corner = |x: f64, y: f64| DVec3::new(x, y, KERB_M);
    [
        (Frame::new(corner(a.x, a.y), DVec2::X), b.x - a.x),
        (Frame::new(corner(b.x, a.y), DVec2::Y), b.y - a.y),
        (Frame::new(corner(b.x, b.y), DVec2::NEG_X), b.x - a.x),
        (Frame::new(corner(a.x, b.y), DVec2::NEG_Y), b.y - a.y),
    ]
}

fn terrace(builder: &mut Builder, block: &Block, random: &mut SplitMix64) {
    let depth = 9.6;
    for (side, (frame, length)) in sides(block).into_iter().enumerate() {
        // Houses on the long sides occupy the corners. The others stand between them.
        let corner = if side % 2 == 0 { PAVEMENT_M } else { PAVEMENT_M + depth };
        let room = length - 2.0 * corner;
        let count = (room / random.range(8.0, 9.6)).floor().max(1.0);
        let width = room / count;
        let base_storeys = 2 + random.index(2) as u32;
        for i in 0..count as u32 {
            let inner = i > 0 && f64::from(i) < count - 1.0;
            if inner && random.chance(0.07) {
                let x = corner + (f64::from(i) + 0.5) * width;
                let at = frame.point(DVec3::new(x, PAVEMENT_M + 5.0, 0.0));
                builder.tree(at, random.range(7.0, 10.0), random);
                continue;
            }
            let at = DVec3::new(corner + f64::from(i) * width, PAVEMENT_M, 0.0);
            let house = House {
                frame: frame.moved(at),
                width,
                depth,
                storeys: base_storeys + u32::from(random.chance(0.35)),
                pitch: random.range(0.72, 1.0),
                attached: inner,
                shop: random.chance(0.25),
            };
            builder.house(&house, random);
        }
    }
    let inset = DVec2::splat(PAVEMENT_M + depth + 2.5);
    let (min, max) = (block.min + inset, block.max - inset);
    let room = max - min;
    if room.min_element() > 3.0 {
        for _ in 0..(room.x * room.y / 70.0).ceil() as u32 {
            let at = DVec3::new(random.range(min.x, max.x), random.range(min.y, max.y), KERB_M);
            if random.chance(0.2) {
                builder.conifer(at, random.range(6.0, 11.0), random);
            } else {
                builder.tree(at, random.range(5.0, 10.0), random);
            }
        }
        let shed = Frame::new(min.extend(KERB_M), DVec2::X);
        let house = House {
            frame: shed,
            width: 4.5,
            depth: 3.2,
            storeys: 1,
            pitch: 0.45,
            attached: true,
            shop: false,
        };
        builder.house(&house, random);
    }
}

fn villas(builder: &mut Builder, block: &Block, random: &mut SplitMix64) {
    let extent = block.max - block.min - 2.0 * PAVEMENT_M;
    let counts = (extent / 19.0).floor().max(DVec2::ONE);
    let lot = extent / counts;
    for j in 0..counts.y as u32 {
        for i in 0..counts.x as u32 {
            let corner = block.min + PAVEMENT_M + DVec2::new(f64::from(i), f64::from(j)) * lot;
            let (width, depth) = (random.range(9.0, 11.5), random.range(8.0, 9.0));
            let turned = random.chance(0.5);
            let size = if turned { DVec2::new(depth, width) } else { DVec2::new(width, depth) };
            let free = (lot - size - 2.0).max(DVec2::ZERO);
            let at =
                corner + 1.0 + free * DVec2::new(random.range(0.3, 0.7), random.range(0.3, 0.7));
            let frame = if turned {
                Frame::new((at + DVec2::new(depth, 0.0)).extend(KERB_M), DVec2::Y)
            } else {
                Frame::new(at.extend(KERB_M), DVec2::X)
            };
            let house = House {
                frame,
                width,
                depth,
                storeys: 1 + u32::from(random.chance(0.6)),
                pitch: random.range(0.6, 0.95),
                attached: false,
                shop: false,
            };
            builder.house(&house, random);
            for _ in 0..3 {
                let spot =
                    corner + lot * DVec2::new(random.range(0.06, 0.94), random.range(0.06, 0.94));
                let inside = spot.cmpgt(at - 1.8).all() && spot.cmplt(at + size + 1.8).all();
                if !inside && random.chance(0.25) {
                    builder.conifer(spot.extend(KERB_M), random.range(5.0, 9.0), random);
                } else if !inside {
                    builder.tree(spot.extend(KERB_M), random.range(4.0, 8.0), random);
                }
            }
        }
    }
    for (frame, length) in sides(block) {
        let hedge = frame.moved(DVec3::new(PAVEMENT_M + 1.0, PAVEMENT_M + 0.4, 0.0));
        let room = length - 2.0 * PAVEMENT_M - 2.0;
        let gate = random.range(0.3, 0.7) * room;
        builder.hedge(&hedge, gate - 1.5, random);
        builder.hedge(&hedge.moved(DVec3::new(gate + 1.5, 0.0, 0.0)), room - gate - 1.5, random);
    }
}

fn square(builder: &mut Builder, block: &Block, random: &mut SplitMix64) {
    let extent = block.max - block.min;
    let middle = (block.min + block.max) * 0.5;
    let length = (0.46 * extent.x).min(27.0);
    let west = DVec2::new(middle.x - 0.32 * length, middle.y + 0.2 * extent.y);
    builder.church(&Frame::new(west.extend(KERB_M), DVec2::X), length, random);
    let fountain = DVec2::new(middle.x - 0.2 * extent.x, middle.y - 0.2 * extent.y);
    builder.fountain(fountain.extend(KERB_M));
    for i in 0..6 {
        let (row, column) = (i / 3, i % 3);
        let at = middle
            + DVec2::new(
                0.04 * extent.x + 5.2 * f64::from(column),
                -0.3 * extent.y + 6.0 * f64::from(row),
            );
        builder.stall(&Frame::new(at.extend(KERB_M), DVec2::X), random);
    }
    for _ in 0..16 {
        let at = middle
            + DVec2::new(random.range(-0.4, 0.42) * extent.x, random.range(-0.4, -0.08) * extent.y);
        if (at - fountain).length() > 3.5 {
            builder.person(at.extend(KERB_M), random);
        }
    }
    for (frame, length) in sides(block) {
        let count = (length / 8.5).floor();
        for i in 0..count as u32 {
            let x = length * (f64::from(i) + 0.5) / count;
            let at = frame.point(DVec3::new(x, PAVEMENT_M + 1.2, 0.0));
            let clear = (at.y - west.y).abs() > 0.3 * length || at.y < middle.y;
            if clear && (at.x - middle.x).abs() > 0.2 * extent.x || at.y < middle.y - 0.3 * extent.y
            {
                builder.tree(at, random.range(5.5, 7.5), random);
            }
            if i % 2 == 1 {
                builder.bench(&frame.moved(DVec3::new(x + 2.5, PAVEMENT_M + 1.2, 0.0)));
            }
        }
    }
}

fn park(builder: &mut Builder, block: &Block, random: &mut SplitMix64) {
    let extent = block.max - block.min;
    let middle = (block.min + block.max) * 0.5;
    builder.fountain(middle.extend(KERB_M));
    for i in 0..8 {
        let (s, c) = sin_cos(f64::from(i) * std::f64::consts::FRAC_PI_4 + 0.39);
        let at = middle + DVec2::new(c, s) * 10.8;
        builder.bench(&Frame::new(at.extend(KERB_M), DVec2::new(s, -c)).turned(2));
    }
    let mut planted: Vec<DVec2> = Vec::new();
    for _ in 0..(extent.x * extent.y / 40.0) as u32 {
        let spot = DVec2::new(random.unit(), random.unit()) * (extent - 9.0) + block.min + 4.5;
        let from_path = (spot - middle).abs().min_element() - 1.5;
        let crowded = planted.iter().any(|other| (*other - spot).length() < 5.0);
        if from_path < 1.0 || (spot - middle).length() < 12.5 || crowded {
            continue;
        }
        planted.push(spot);
        if random.chance(0.2) {
            builder.conifer(spot.extend(KERB_M), random.range(9.0, 15.0), random);
        } else {
            builder.tree(spot.extend(KERB_M), random.range(8.0, 14.0), random);
        }
    }
}

/// Adds lamps, signs, people and street trees on the pavement.
fn kerbside(builder: &mut Builder, block: &Block, random: &mut SplitMix64) {
    for (frame, length) in sides(block) {
        let trees = block.usage != Use::Square && random.chance(0.5);
        let count = (length / 11.0).floor().max(1.0);
        for i in 0..count as u32 {
            let x = length * (f64::from(i) + 0.5) / count;
            let spot = frame.moved(DVec3::new(x, 0.55, 0.0));
            if i % 2 == 0 {
                builder.lamp(&spot.turned(3));
            } else if trees {
                builder.tree(spot.origin, random.range(5.0, 7.5), random);
            }
            if random.chance(0.3) {
                let at = DVec3::new(x + random.range(1.0, 4.0), random.range(0.9, 2.0), 0.0);
                builder.person(frame.point(at), random);
            }
        }
        if random.chance(0.7) {
            let color = [0x2456a4, 0xb5232a, 0xe0c23a][random.index(3)];
            builder.sign(&frame.moved(DVec3::new(4.0, 0.45, 0.0)), color);
        }
    }
}

/// Adds cars along both kerbs of every street, and a few moving ones.
fn parked_cars(builder: &mut Builder, plan: &Plan, random: &mut SplitMix64) {
    let blocks: Vec<_> = plan.blocks.iter().flat_map(sides).collect();
    for (frame, length) in blocks {
        let count = ((length - 14.0) / 5.6).floor().max(0.0);
        for i in 0..count as u32 {
            if !random.chance(0.5) {
                continue;
            }
            let x = 7.0 + 5.6 * (f64::from(i) + 0.5) + random.range(-0.2, 0.2);
            let at = frame.moved(DVec3::new(x, -1.15 + random.range(-0.08, 0.08), -KERB_M));
            builder.car(&at.turned(if random.chance(0.85) { 0 } else { 2 }), random);
        }
        if random.chance(0.5) {
            let x = random.range(0.2, 0.8) * length;
            builder.car(&frame.moved(DVec3::new(x, -0.5 * STREET_M + 1.3, -KERB_M)), random);
        }
    }
}

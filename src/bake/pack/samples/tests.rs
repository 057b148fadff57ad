use glam::Vec2;

use super::*;
use crate::assets::ClipLine;
use crate::bake::kernels::circle;
use crate::scene::random::SplitMix64;

#[test]
fn packing_again_gives_the_same_words() {
    let mut numbers = SplitMix64::new(3);
    let mut next = || (numbers.next_u64() >> 40) as f32 / (1 << 24) as f32 - 0.5;
    let mut cloud = PointCloud::default();
    let (mut normals, mut kernels, mut colors, mut clips) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for index in 0..3000 {
        cloud.positions.push(DVec3::new(next().into(), next().into(), next().into()) * 7.0);
        let normal = Vec3::new(next(), next(), next()).normalize_or(Vec3::X);
        let normal = if index % 17 == 0 { Vec3::ZERO } else { normal };
        normals.push(normal);
        let Kernel { u, v } = circle(normal, 0.02 + 0.01 * next());
        kernels.push(Kernel { u: u * (1.5 + next()), v });
        colors.push([(index % 256) as u8, 3, 90, 255]);
        let lines = [index % 5 == 0, index % 10 == 0].map(|there| {
            there.then(|| ClipLine { normal: Vec2::from_angle(7.0 * next()), offset: next() })
        });
        clips.push(Clip { lines, either: index % 20 == 0 });
    }
    cloud.normals = Some(normals);
    cloud.kernels = Some(kernels);
    cloud.colors = Some(colors);
    cloud.clips = Some(clips);
    let packed = pack_samples(&cloud).unwrap();
    let back = unpack_samples(&packed);
    let again = pack_samples(&back).unwrap();
    // Boxes may differ by a rounding, and with them orders and steps: the test compares positions and attributes instead.
    assert_eq!(again.positions.len(), packed.positions.len());
    assert_eq!(again.clipped_first(), packed.clipped_first());
    let once_more = unpack_samples(&again);
    let step = 2.0 * packed.grid.step * f64::from(1u32 << packed.chunks[0].shift.min(30));
    for (a, b) in back.positions.iter().zip(&once_more.positions) {
        assert!((*a - *b).length() <= step.max(1e-6), "{a} {b}");
    }
    let (a, b) = (back.kernels.unwrap(), once_more.kernels.unwrap());
    for (a, b) in a.iter().zip(&b) {
        assert!((a.u.length() - b.u.length()).abs() <= 0.006 * a.u.length());
        assert!(a.u.angle_between(b.u).sin().abs() < 0.01);
    }
    let (a, b) = (back.clips.unwrap(), once_more.clips.unwrap());
    assert!(a.iter().zip(&b).all(|(a, b)| {
        a.either == b.either
            && a.lines.iter().zip(&b.lines).all(|(a, b)| a.is_some() == b.is_some())
    }));
    assert!(a.iter().any(|clip| clip.either));
}

#[test]
fn chunks_with_alpha_stand_on_pages_of_their_own() {
    let positions = (0..8 * CHUNK).map(|i| DVec3::X * i as f64).collect();
    let alpha = |i: usize| if (2 * CHUNK..3 * CHUNK).contains(&i) { 100 } else { 255 };
    let colors = (0..8 * CHUNK).map(|i| [1, 2, 3, alpha(i)]).collect();
    let cloud = PointCloud { positions, colors: Some(colors), ..PointCloud::default() };
    let packed = pack_samples(&cloud).unwrap();
    for chunk in &packed.chunks {
        let mut colors = packed.attributes[chunk.elements()].iter().map(|[color, _]| color);
        let has_alpha = colors.any(|color| color >> 24 < 255);
        assert_eq!((chunk.translucent, packed.page(chunk).translucent), (has_alpha, has_alpha));
    }
    let translucent = packed.chunks.iter().filter(|chunk| chunk.translucent).count();
    assert!((1..=3).contains(&translucent), "{translucent} of {}", packed.chunks.len());
}

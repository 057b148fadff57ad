use super::*;

fn grey(values: impl IntoIterator<Item = u8>) -> Vec<[u8; 4]> {
    values.into_iter().map(|v| [v, v, v, 255]).collect()
}

/// A picture with much detail, and variants of it for `k` > 0.
fn picture(width: u32, height: u32, k: u32) -> Vec<[u8; 4]> {
    let pixel = |i: u32| {
        let (x, y) = (i % width, i / width);
        let r = x * 7 + y * 3 + k * ((x * x + y * 5) % 23);
        let g = x * y + k * (x % 5) * 9;
        let b = x * 2 + y * 11 + k * ((x + y) % 7) * 4;
        [r as u8, g as u8, b as u8, 255]
    };
    (0..width * height).map(pixel).collect()
}

#[test]
fn psnr_and_maximum() {
    let a = grey([10, 20, 30, 40]);
    let mut b = a.clone();
    assert_eq!(psnr(&a, &b), Ok(f64::INFINITY));
    assert_eq!(max_error(&a, &b), Ok(0));
    b[1][2] = 14;
    b[3][3] = 0;
    // A single difference of 6 in twelve bytes gives a mean square of 3. Alpha does not count.
    let expected = 10.0 * (65025.0f64 / 3.0).log10();
    assert!((psnr(&a, &b).unwrap() - expected).abs() < 1e-12);
    assert_eq!(max_error(&a, &b), Ok(6));
    // Images without pixels are equal, as for SSIM and FLIP.
    assert_eq!((mse(&[], &[]), psnr(&[], &[])), (Ok(0.0), Ok(f64::INFINITY)));
    let black_white = psnr(&grey([0; 9]), &grey([255; 9])).unwrap();
    assert!(black_white.abs() < 1e-12, "{black_white}");
}

#[test]
fn psnr_and_ssim_agree_with_scikit_image() {
    // Expected values: `structural_similarity(luma, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    // data_range=255)` and `peak_signal_noise_ratio` of scikit-image on the same pictures.
    for (width, height, k, expected_ssim, expected_psnr) in [
        (37, 29, 1, 0.625_421_089_802_803_6, 13.981_285_999_875_2),
        (64, 48, 2, 0.314_681_454_959_591_7, 10.757_083_043_985_574),
        (40, 40, 3, 0.127_139_158_074_543_35, 9.729_696_902_349_772),
    ] {
        let (a, b) = (picture(width, height, 0), picture(width, height, k));
        let found = ssim(&a, &b, width, height).unwrap();
        assert!((found - expected_ssim).abs() < 1e-10, "{found}");
        assert!((psnr(&a, &b).unwrap() - expected_psnr).abs() < 1e-10);
        assert_eq!(ssim(&b, &a, width, height).unwrap(), found);
    }
}

#[test]
fn ssim_of_flat_and_inverted_images() {
    let (a, b) = (grey([100; 400]), grey([150; 400]));
    // Without variance, SSIM compares only the means.
    let c1 = 2.55f64.powi(2);
    let expected = (2.0 * 100.0 * 150.0 + c1) / (100.0 * 100.0 + 150.0 * 150.0 + c1);
    assert!((ssim(&a, &b, 20, 20).unwrap() - expected).abs() < 1e-9);
    let checker = |flip: u32| grey((0..400u32).map(move |i| 255 * ((i + i / 20 + flip) % 2) as u8));
    assert!((ssim(&checker(0), &checker(0), 20, 20).unwrap() - 1.0).abs() < 1e-12);
    assert!(ssim(&checker(0), &checker(1), 20, 20).unwrap() < -0.9);
    // An image smaller than the window.
    assert_eq!(ssim(&grey([9]), &grey([9]), 1, 1), Ok(1.0));
    let small = ssim(&picture(7, 30, 0), &picture(7, 30, 1), 7, 30).unwrap();
    assert!(small > 0.1 && small < 0.9, "{small}");
}

#[test]
fn holes_and_leaks_know_silhouettes() {
    // A block of 6 × 6 pixels in an image of 10 × 10.
    let block = |x: usize, y: usize| (2..8).contains(&x) && (2..8).contains(&y);
    let reference: Vec<bool> = (0..100).map(|i| block(i % 10, i / 10)).collect();
    let mut image = reference.clone();
    let same = coverage(&reference, &image, 10, 10).unwrap();
    assert_eq!((same.covered_reference, same.covered_image), (36, 36));
    assert_eq!((same.holes, same.leaks, same.silhouette_iou), (0, 0, 1.0));
    image[2 * 10 + 4] = false; // on the edge
    image[5 * 10 + 5] = false; // in the middle
    image[4 * 10 + 8] = true; // beside the edge
    image[10 + 1] = true; // touches a corner
    image[0] = true; // in the image's corner, on its own
    let found = coverage(&reference, &image, 10, 10).unwrap();
    assert_eq!((found.holes, found.holes_inside), (2, 1));
    assert_eq!((found.leaks, found.leaks_outside), (3, 1));
    assert!((found.silhouette_iou - 34.0 / 39.0).abs() < 1e-15);
    let nothing = coverage(&[false; 4], &[false; 4], 2, 2).unwrap();
    assert_eq!(nothing.silhouette_iou, 1.0);
    // A hole in the image's corner has neighbours on three sides only.
    let corner = coverage(&[true; 4], &[false, true, true, true], 2, 2).unwrap();
    assert_eq!((corner.holes, corner.holes_inside), (1, 1));
    assert_eq!(covered_by_id(&[0, 3]), [false, true]);
    assert_eq!(covered_by_depth(&[f32::INFINITY, 2.0]), [false, true]);
}

#[test]
fn depth_errors_are_relative_and_where_both_are_covered() {
    let mut reference = vec![10.0f64; 200];
    let mut image = vec![10.0f32; 200];
    reference[0] = f64::INFINITY;
    image[1] = f32::INFINITY;
    image[2] = 15.0;
    image[3] = 9.0;
    let found = depth_error(&reference, &image).unwrap().unwrap();
    assert_eq!((found.pixels, found.max), (198, 0.5));
    assert!((found.mean - 0.6 / 198.0).abs() < 1e-15);
    // The rank is ⌈0.99 · 198⌉ = 197 of 198: the second largest error.
    assert!((found.p99 - 0.1).abs() < 1e-15);
    assert_eq!(depth_error(&[f64::INFINITY], &[1.0]).unwrap(), None);
    // Depths in the eye's plane have no ratio, and agree where they are equal. An infinite error would be `null` in the journal.
    let flat = depth_error(&[0.0, 0.0, 1e-310, 2.0], &[1.0, 0.0, -1.0, 3.0]).unwrap().unwrap();
    assert_eq!((flat.pixels, flat.max, flat.mean), (2, 0.5, 0.25));
}

#[test]
fn normal_errors_are_angles() {
    let turned =
        |degrees: f64| DVec3::new(0.0, degrees.to_radians().sin(), degrees.to_radians().cos());
    let reference = vec![DVec3::Z; 4];
    let image = [turned(1e-5), turned(90.0), DVec3::ZERO, turned(180.0)];
    let found = normal_error_deg(&reference, &image).unwrap().unwrap();
    assert_eq!(found.pixels, 3);
    assert!((found.max - 180.0).abs() < 1e-9 && (found.mean - 270.00001 / 3.0).abs() < 1e-9);
    // Normals that are not finite do not count.
    let broken = [DVec3::NAN, DVec3::Z, DVec3::new(0.0, f64::INFINITY, 0.0), DVec3::Z];
    let found = normal_error_deg(&reference, &broken).unwrap().unwrap();
    assert_eq!((found.pixels, found.max, found.mean), (2, 0.0, 0.0));
    let small = normal_error_deg(&[DVec3::Z], &[turned(1e-5)]).unwrap().unwrap();
    assert!((small.max - 1e-5).abs() < 1e-15);
    let bytes = normals_from_rgba8(&[[128, 1, 255, 255], [0, 0, 0, 0]]);
    assert_eq!(bytes, [DVec3::new(0.0, -1.0, 1.0), DVec3::ZERO]);
}

#[test]
fn sizes_must_agree() {
    let (a, b) = (grey([0; 4]), grey([0; 5]));
    assert!(psnr(&a, &b).is_err() && max_error(&a, &b).is_err());
    let message = ssim(&a, &a, 3, 2).unwrap_err().to_string();
    assert!(message.contains("3 × 2") && message.contains('4'), "{message}");
    assert!(coverage(&[true], &[true], 1, 2).is_err());
    assert!(depth_error(&[1.0], &[1.0, 2.0]).is_err());
    assert!(normal_error_deg(&[], &[DVec3::Z]).is_err());
}

/// Compares with a search through all pairs.
#[test]
fn the_farthest_pixel_is_found() {
    let (width, height) = (23, 17);
    let mut random = crate::scene::random::SplitMix64::new(9);
    for density in [0.01, 0.05, 0.3] {
        let mut mask =
            || -> Vec<bool> { (0..width * height).map(|_| random.chance(density)).collect() };
        let (from, to) = (mask(), mask());
        let place = |pixel: usize| [(pixel % width) as f64, (pixel / width) as f64];
        let of = |mask: &[bool]| -> Vec<[f64; 2]> {
            (0..mask.len()).filter(|&pixel| mask[pixel]).map(place).collect()
        };
        let nearest = |a: &[f64; 2]| {
            let ways = of(&to).into_iter().map(|b| (a[0] - b[0]).hypot(a[1] - b[1]));
            ways.fold(f64::INFINITY, f64::min)
        };
        let expected = of(&from).iter().map(nearest).fold(0.0, f64::max);
        let found = farthest_px(&from, &to, width as u32, height as u32).unwrap();
        assert!((found - expected).abs() < 1e-9, "{found}, not {expected}");
    }
    let (none, all) = (vec![false; 4], vec![true; 4]);
    assert_eq!(farthest_px(&all, &none, 2, 2), Ok(f64::INFINITY));
    assert_eq!(farthest_px(&none, &all, 2, 2), Ok(0.0));
    assert!(farthest_px(&none, &all, 3, 2).is_err());
}

#[test]
fn masks_shrink_from_all_sides_but_the_border() {
    let mut mask = vec![true; 7 * 5];
    mask[2 * 7 + 5] = false;
    let found = shrunk(&mask, 7, 5, 1).unwrap();
    for (i, &kept) in found.iter().enumerate() {
        let away = (i % 7).abs_diff(5).max((i / 7).abs_diff(2));
        assert_eq!(kept, away > 1, "{i}");
    }
    assert_eq!(shrunk(&mask, 7, 5, 0).unwrap(), mask);
    assert!(shrunk(&mask, 7, 4, 1).is_err());
}

#[test]
fn areas_are_connected_by_sides() {
    let text = "\
        ##..#\
        #..#.\
        ..##.\
        #...#";
    let mask: Vec<bool> = text.chars().map(|c| c == '#').collect();
    let mut sizes = areas(&mask, 5, 4).unwrap();
    sizes.sort_unstable();
    assert_eq!(sizes, [1, 1, 1, 3, 3]);
    assert!(areas(&[], 0, 0).unwrap().is_empty());
    assert!(areas(&mask, 4, 4).is_err());
}

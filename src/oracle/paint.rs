//! Splats painted over each other (Coconu & Hege 2002, §5.4).
//!
//! They come in the order of the distances of their centres from the eye, or of their depths where rays are parallel, the nearest first. A
//! splat covers at a pixel what a Gaussian somewhat wider than its kernel is worth there, low-pass filtered, and hides as much as
//! [`PAINT_LAYERS`] of that, one over the other. What opaque surfaces hide is not painted.
//!
//! Each splat is laid under what came before it, or, as [`Painting::Surfaces`], each surface: the splats up to the depth that the first of
//! them reaches behind itself, with the weighted mean of their colours.

use glam::DVec2;
use rayon::prelude::*;

use crate::math::View;
use crate::scene::{PAINT_LAYERS, Painting};

use super::blend::{Splat, seen_splats};
use super::prepare::Prepared;
use super::splats::{Settings, Touch};
use super::visibility::{Hit, band_rows, pixel_ray};

/// From how many e-folds on a surface hides more than its splats one after the other, and how much more.
const CLOSED_FROM: f64 = 2.0;
const CLOSING: f64 = 1.8;

/// A pixel on the way from front to back.
#[derive(Clone, Copy, Default)]
struct Canvas {
    /// Multiplied by alpha.
    color: [f64; 3],
    alpha: f64,
    surface: Surface,
}

/// The surface that is being painted.
#[derive(Clone, Copy, Default)]
struct Surface {
    weight: f64,
    color: [f64; 3],
    /// The share of the light from behind that passes it.
    through: f64,
    /// Depth up to which splats belong to it, and the side that is seen.
    reach: f64,
    facing: i8,
}

impl Canvas {
    fn under(&mut self, color: [f64; 3], alpha: f64) {
        let share = alpha * (1.0 - self.alpha);
        for (sum, channel) in self.color.iter_mut().zip(color) {
            *sum += channel * share;
        }
        self.alpha += share;
    }

    fn add(&mut self, splat: &Splat, touch: &Touch, cover: f64) {
        let through = (1.0 - cover).powi(PAINT_LAYERS as i32);
        let surface = &self.surface;
        let is_beside = touch.depth <= surface.reach && splat.facing * surface.facing >= 0;
        if surface.weight == 0.0 || !is_beside {
            self.finish_surface();
            let reach = touch.depth + splat.seen.offset;
            self.surface = Surface { reach, through: 1.0, facing: splat.facing, ..self.surface };
        }
        let weight = splat.seen.painted_weight(touch);
        let surface = &mut self.surface;
        surface.weight += weight;
        surface.through *= through;
        for (sum, channel) in surface.color.iter_mut().zip(splat.color) {
            *sum += weight * channel;
        }
    }

    fn finish_surface(&mut self) {
        let surface = std::mem::take(&mut self.surface);
        if surface.weight > 0.0 {
            let color = surface.color.map(|channel| channel / surface.weight);
            // Where splats of a surface lie over each other, it hides more than they do one after the other: it goes on there.
            let layers = -surface.through.ln();
            let more = (layers - CLOSED_FROM).max(0.0);
            self.under(color, 1.0 - (-layers - CLOSING * more * more).exp());
        }
    }
}

/// Paints the scene's splats over an image, whose colours are linear with straight alpha. `hits`: the opaque surfaces that it shows.
pub fn paint(
    prepared: &Prepared<'_>,
    view: &View,
    (settings, each): (&Settings, Painting),
    hits: &[Option<Hit>],
    image: &mut [[f64; 4]],
) {
    let mut splats = seen_splats(prepared, view, settings, |_| true);
    let distance = |splat: &Splat| splat.seen.distance(view.is_orthographic());
    splats.sort_by(|a, b| distance(a).total_cmp(&distance(b)).then_with(|| a.rank.cmp(&b.rank)));
    let width = (view.width as usize).max(1);
    let rows = band_rows(view.height as usize);
    image.par_chunks_mut(width * rows).enumerate().for_each(|(band, pixels)| {
        let first_row = band * rows;
        let mut canvas = vec![Canvas::default(); pixels.len()];
        for splat in &splats {
            let [x0, x1, y0, y1] = splat.seen.pixel_box;
            for y in y0.max(first_row)..y1.min(first_row + pixels.len() / width) {
                for x in x0..x1 {
                    let hit = hits[y * width + x];
                    let Some(touch) = touch_at(prepared, view, splat, hit, (x, y)) else {
                        continue;
                    };
                    let canvas = &mut canvas[(y - first_row) * width + x];
                    let cover = splat.seen.cover(&touch);
                    match each {
                        Painting::Surfaces => canvas.add(splat, &touch, cover),
                        Painting::Splats => {
                            let through = (1.0 - cover).powi(PAINT_LAYERS as i32);
                            canvas.under(splat.color, 1.0 - through);
                        }
                    }
                }
            }
        }
        for (pixel, mut canvas) in pixels.iter_mut().zip(canvas) {
            canvas.finish_surface();
            lay_over(pixel, &canvas);
        }
    });
}

/// A splat's values at a pixel that shows it.
fn touch_at(
    prepared: &Prepared<'_>,
    view: &View,
    splat: &Splat,
    hit: Option<Hit>,
    (x, y): (usize, usize),
) -> Option<Touch> {
    let ray = pixel_ray(view, x, y);
    let touch = splat.seen.at(DVec2::new(x as f64 + 0.5, y as f64 + 0.5), ray)?;
    let is_hidden = hit.is_some_and(|hit| hit.depth < touch.depth);
    let is_shown = touch.is_within && !is_hidden;
    (is_shown && prepared.shows(view, view.at_depth(ray, touch.depth))).then_some(touch)
}

/// Lays what was painted over a pixel (Porter & Duff 1984, *over*).
fn lay_over(pixel: &mut [f64; 4], canvas: &Canvas) {
    let below = pixel[3] * (1.0 - canvas.alpha);
    let sum = canvas.alpha + below;
    if canvas.alpha > 0.0 {
        let mean = |i: usize| (canvas.color[i] + pixel[i].clamp(0.0, 1.0) * below) / sum;
        *pixel = [mean(0), mean(1), mean(2), sum];
    }
}

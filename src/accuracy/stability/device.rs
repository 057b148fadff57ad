//! Runs the functions of `shared/splat` on the adapter, on splats of the report (`shaders/measure/measure_splats.wgsl`).

#[cfg(test)]
use std::mem::offset_of;

use bytemuck::{Pod, Zeroable};
use glam::{DMat2, DVec2, IVec2, Vec2, Vec3, Vec4, dvec2};

use super::StabilityError;
use super::cases::{Disk, Lens};
use super::truth::DIRECTIONS;
use crate::gpu::buffer::Buffer;
use crate::gpu::pipeline::{BindingSlot, ComputePipeline, Shader};
use crate::gpu::readback::Ring;
use crate::gpu::{Gpu, GpuOptions};
use crate::passes::shaders::{Choices, composed};

const ENTRY: &str = "measure_splats";
/// Threads per workgroup.
const LANES: u32 = 64;
/// Size of the uniforms in the pipeline's layout, which the shader does not read.
const UNIFORM_BYTES: u64 = 16 << 10;

/// Input of the shader: a splat.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Probe {
    centre: Vec3,
    cutoff: f32,
    u: Vec3,
    pad_u: f32,
    v: Vec3,
    pad_v: f32,
    focal_px: Vec2,
    principal_px: Vec2,
    points_px: [Vec2; DIRECTIONS],
}

/// Output of the shader for a splat.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Found {
    side: u32,
    pad: u32,
    /// Image of the disk's centre, the origin of offsets.
    pub centre_px: Vec2,
    /// Linear functions of the offset: constant and slopes.
    s: Vec3,
    pad_s: f32,
    t: Vec3,
    pad_t: f32,
    /// First and last pixel of the splat's box.
    pub low: IVec2,
    pub high: IVec2,
    kernels: [Vec4; DIRECTIONS],
}

/// The shader's classification of a disk relative to the camera plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Behind the camera plane, or without area.
    Unseen,
    Regular,
    Crosses,
}

/// An ellipse in the image plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    pub centre: DVec2,
    /// Conjugate radii: the outline is `centre + cos·radii.x_axis + sin·radii.y_axis`.
    radii: DMat2,
}

impl Ellipse {
    /// The largest `d·x` on the outline: its support function.
    pub fn support(&self, d: DVec2) -> f64 {
        self.centre.dot(d) + (self.radii.transpose() * d).length()
    }
}

impl Probe {
    #[cfg(test)]
    pub const OFFSETS: [usize; 8] = [
        offset_of!(Probe, centre),
        offset_of!(Probe, cutoff),
        offset_of!(Probe, u),
        offset_of!(Probe, v),
        offset_of!(Probe, focal_px),
        offset_of!(Probe, principal_px),
        offset_of!(Probe, points_px),
        size_of::<Probe>(),
    ];

    /// Describes a disk that was multiplied by the intrinsics of `lens`. `points_px` are the points at which the shader computes
    /// kernel coordinates.
    pub fn new(disk: &Disk, cutoff: f32, lens: &Lens, points_px: [Vec2; DIRECTIONS]) -> Probe {
        let [u, v] = disk.tangents;
        Probe {
            centre: disk.centre,
            cutoff,
            u,
            v,
            focal_px: lens.focal_px,
            principal_px: lens.principal_px,
            points_px,
            ..Probe::default()
        }
    }

    pub fn points_px(&self) -> &[Vec2; DIRECTIONS] {
        &self.points_px
    }

    /// Whether the disk is seen edge-on to the shader's precision, by the volume of both tangents and the centre relative to
    /// their largest coordinate.
    pub fn is_flat(&self) -> bool {
        const LEAST: f64 = 1e-29;
        let [p, u, v] = [self.centre, self.u, self.v].map(|v| v.as_dvec3());
        let size = p.abs().max(u.abs()).max(v.abs()).max_element();
        (u / size).cross(v / size).dot(p / size).abs() <= LEAST || size == 0.0
    }
}

impl Found {
    #[cfg(test)]
    pub const OFFSETS: [usize; 8] = [
        offset_of!(Found, side),
        offset_of!(Found, centre_px),
        offset_of!(Found, s),
        offset_of!(Found, t),
        offset_of!(Found, low),
        offset_of!(Found, high),
        offset_of!(Found, kernels),
        size_of::<Found>(),
    ];

    pub fn side(&self) -> Side {
        match self.side {
            0 => Side::Unseen,
            1 => Side::Regular,
            _ => Side::Crosses,
        }
    }

    /// The ellipse on which `s² + t²` is the square of `cutoff`, evaluated in f64 so that only the shader's result is judged.
    /// `None` if it degenerates to lines: lengths beyond 10¹⁵ px overflow.
    pub fn ellipse(&self, cutoff: f32) -> Option<Ellipse> {
        let [s, t] = [self.s, self.t].map(|form| form.as_dvec3());
        let determinant = s.y * t.z - s.z * t.y;
        (determinant != 0.0).then(|| {
            let inverse =
                DMat2::from_cols(dvec2(t.z, -t.y), dvec2(-s.z, s.y)) * determinant.recip();
            let centre = self.centre_px.as_dvec2() - inverse * dvec2(s.x, t.x);
            Ellipse { centre, radii: inverse * f64::from(cutoff) }
        })
    }

    /// Kernel coordinates at one of the points; `None` behind the disk's horizon, and where they are so large that no pixel is
    /// covered.
    pub fn kernel(&self, point: usize) -> Option<DVec2> {
        const MOST: f64 = (1 << 30) as f64;
        let [s, t, n, _] = self.kernels[point].to_array().map(f64::from);
        let kernel = dvec2(s, t) / n;
        (n > 0.0 && kernel.abs().max_element() < MOST).then_some(kernel)
    }

    pub fn is_finite(&self) -> bool {
        let forms = self.s.is_finite() && self.t.is_finite() && self.centre_px.is_finite();
        forms && self.kernels.iter().all(|kernel| kernel.is_finite())
    }
}

/// The shader's filter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    Perspective,
    Exact,
}

/// The adapter with the report's pipelines.
pub struct Device {
    gpu: Gpu,
    perspective: ComputePipeline,
    exact: ComputePipeline,
}

impl Device {
    /// Opens the adapter that draws frames.
    ///
    /// # Errors
    /// There is no adapter, or a shader does not compile, which is a defect of the program.
    pub fn open() -> Result<Device, StabilityError> {
        let gpu = Gpu::open(&GpuOptions::default())?;
        let composed = composed("measure/measure_splats", &Choices::default())?;
        let shader = Shader::new(&gpu, ENTRY, &composed, wgpu::ShaderStages::COMPUTE)?;
        let pipeline = |filter: u32| {
            let constants = [
                ("FILTER", f64::from(filter)),
                ("PREFILTER", 0.0),
                ("GENERAL", 1.0),
                ("WEIGHTED", 1.0),
            ];
            ComputePipeline::new(&gpu, &shader, &constants)
        };
        let (perspective, exact) = (pipeline(1), pipeline(2));
        Ok(Device { perspective, exact, gpu })
    }

    pub fn adapter(&self) -> &str {
        &self.gpu.name
    }

    /// Runs the shader on splats.
    ///
    /// # Errors
    /// The adapter was lost.
    pub fn measure(&self, filter: Filter, probes: &[Probe]) -> Result<Vec<Found>, StabilityError> {
        let (gpu, bytes) =
            (&self.gpu, size_of_val(probes) / size_of::<Probe>() * size_of::<Found>());
        let pipeline = match filter {
            Filter::Perspective => &self.perspective,
            Filter::Exact => &self.exact,
        };
        let uniform = Buffer::new(gpu, ENTRY, UNIFORM_BYTES, wgpu::BufferUsages::UNIFORM);
        let read = Buffer::with_data(gpu, ENTRY, probes);
        let write = Buffer::storage(gpu, ENTRY, bytes as u64);
        let landing = Ring::default().take(gpu, bytes as u64);
        let mut encoder =
            gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&pipeline.pipeline);
            let bound = |slot: &BindingSlot| {
                let buffer = match slot.access {
                    wgpu::BufferBindingType::Uniform => &uniform,
                    wgpu::BufferBindingType::Storage { read_only: true } => &read,
                    wgpu::BufferBindingType::Storage { read_only: false } => &write,
                };
                wgpu::BindGroupEntry {
                    binding: slot.number,
                    resource: buffer.raw().as_entire_binding(),
                }
            };
            for (number, layout) in pipeline.layouts.iter().enumerate() {
                let slots = &pipeline.bindings[number];
                let entries: Vec<_> = slots.iter().map(bound).collect();
                let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some(ENTRY),
                    layout,
                    entries: &entries,
                });
                let offsets = vec![0; slots.iter().filter(|slot| slot.dynamic).count()];
                pass.set_bind_group(number as u32, &group, &offsets);
            }
            pass.dispatch_workgroups((probes.len() as u32).div_ceil(LANES), 1, 1);
        }
        encoder.copy_buffer_to_buffer(write.raw(), 0, landing.buffer(), 0, bytes as u64);
        gpu.queue.submit([encoder.finish()]);
        landing.map();
        let waited = gpu.device.poll(wgpu::PollType::wait_indefinitely());
        waited.map_err(|_| StabilityError::Lost)?;
        let found = landing.read(bytes as u64, bytemuck::pod_collect_to_vec);
        found.ok_or(StabilityError::Lost)
    }
}

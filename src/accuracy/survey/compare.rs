//! Draws one row at a pose and compares it with the reference.
//!
//! A row whose frames are drawn smaller than they are shown is enlarged first: colours and coverage bilinearly, as a browser enlarges the moving
//! frames of a stream, and depths and normals to the nearest pixel.

use super::{NamedPose, Purpose, Survey, SurveyError};
use crate::accuracy::difference::{Difference, Shot};
use crate::accuracy::enlarge::{bilinear, nearest};
use crate::accuracy::journal::{Metrics, OtherMetrics, Record};
use crate::accuracy::metrics;
use crate::accuracy::report::heat;
use crate::accuracy::sweep::Row;
use crate::accuracy::truth::{Truth, floats, is_covered, opaque, quads};
use crate::engine::{EncodedFrame, FrameRequest, Receipt};
use crate::plan::Output;

impl Survey<'_> {
    /// Opaque pixels of a row's frame, in the size that it is shown at.
    pub(super) fn pixels(&self, row: &Row, frame: &EncodedFrame) -> Vec<[u8; 4]> {
        self.enlarged(row, quads(&frame.bytes).into_iter().map(opaque).collect())
    }

    fn enlarged(&self, row: &Row, pixels: Vec<[u8; 4]>) -> Vec<[u8; 4]> {
        bilinear(pixels, row.drawn_size(self.size), self.size)
    }

    /// Draws all outputs of a row, compares them with the reference, and writes the frame and its FLIP map. For the planner, it draws the
    /// colours only and computes their squared error.
    pub(super) fn compare(
        &self,
        pose: &NamedPose,
        row: &Row,
        truth: &Truth,
    ) -> Result<Record, SurveyError> {
        let request = self.row_request(pose.camera, row);
        let frame = self.draw(request.clone())?;
        let color = self.pixels(row, &frame);
        let image = |metrics| Record::Image {
            pose: pose.name.clone(),
            row: row.label.clone(),
            metrics: Box::new(metrics),
            drawn: Box::new(frame.receipt.settings.applied),
            notes: notes(&frame.receipt),
        };
        if self.purpose == Purpose::Planner {
            let mse = metrics::mse(&truth.color, &color)?;
            return Ok(image(Metrics { mse, others: None }));
        }
        let settings = request.settings.finer(1, true);
        let seen = self.draw(FrameRequest { settings, ..request.clone() })?;
        let seen = self.enlarged(row, quads(&seen.bytes));
        let covered: Vec<bool> = seen.into_iter().map(is_covered).collect();
        // Depths and normals of another drawing say nothing about this one.
        let instead = frame.receipt.settings.instead_because;
        let own = |output| {
            let frame = self.draw(FrameRequest { output, ..request.clone() })?;
            let is_own = frame.receipt.settings.instead_because == instead;
            Ok::<_, SurveyError>(is_own.then_some(frame))
        };
        let size = row.drawn_size(self.size);
        let depth =
            own(Output::Depth)?.map(|frame| nearest(&floats(&frame.bytes), size, self.size));
        let depth = depth.map(|depth| metrics::depth_error(&truth.depth, &depth)).transpose()?;
        let normals = metrics::normals_from_rgba8(&truth.normal);
        let normal = own(Output::Normal)?.map(|frame| {
            let own = nearest(&quads(&frame.bytes), size, self.size);
            let own = metrics::normals_from_rgba8(&own);
            metrics::normal_error_deg(&normals, &own)
        });
        let shot = Shot { color: &color, covered: &covered };
        let Difference { mse, ssim, flip, max_error, coverage, map } =
            Difference::between(truth.shot(), shot, self.size)?;
        let (depth, normal_deg) = (depth.flatten(), normal.transpose()?.flatten());
        let others = OtherMetrics { ssim, flip, max_error, coverage, depth, normal_deg };
        if let Some(file) = self.file(pose, &row.slug(), "") {
            self.write_png(&file, color)?;
        }
        if let Some(file) = self.file(pose, &row.slug(), "-flip") {
            self.write_png(&file, map.into_iter().map(heat).collect())?;
        }
        Ok(image(Metrics { mse, others: Some(others) }))
    }
}

/// The receipt's reasons for drawing in another way than requested.
pub(super) fn notes(receipt: &Receipt) -> Vec<String> {
    let used = &receipt.settings;
    let because = used.because.clone();
    let instead = used.instead_because.map(str::to_owned);
    [because, instead, used.full_because.clone()].into_iter().flatten().collect()
}

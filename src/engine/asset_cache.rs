//! Assets that scenes share.

use std::collections::HashMap;
use std::sync::{Arc, Weak};

use parking_lot::Mutex;
use serde::{Deserialize, Serialize};

use super::EngineError;
use super::asset_keys::AssetKey;
use crate::assets::Placement;
use crate::bake::upright::Shape;
use crate::math::{Camera, Sensor};
use crate::residency::model::AssetModel;

struct CachedAsset {
    model: Weak<AssetModel>,
    extras: Extras,
}

/// The contents of an asset's file other than its model.
#[derive(Clone, Serialize, Deserialize)]
pub struct Extras {
    pub placements: Arc<Vec<Placement>>,
    pub cameras: Vec<(String, Camera)>,
    pub sensor: Option<Sensor>,
    /// Measured only for bare assets.
    pub shape: Option<Shape>,
    pub warnings: Vec<String>,
}

/// An asset after reading, shared between scenes.
pub struct ReadAsset {
    pub model: Arc<AssetModel>,
    pub extras: Extras,
    pub digest: [u8; 32],
}

/// Assets by content, so that scenes that draw the same file share it.
#[derive(Default)]
pub struct AssetCache {
    assets: Mutex<HashMap<[u8; 32], CachedAsset>>,
}

impl AssetCache {
    /// Returns the asset of a key, reading it if no scene draws it yet.
    pub fn get_or_read(
        &self,
        AssetKey { digest, alone }: AssetKey,
        is_bare: bool,
        read: impl FnOnce() -> Result<ReadAsset, EngineError>,
    ) -> Result<ReadAsset, EngineError> {
        if alone
            && let Some(found) = self.assets.lock().get(&digest)
            && let Some(model) = found.model.upgrade()
            // A scene file does not measure the shapes of its assets.
            && (found.extras.shape.is_some() || !is_bare)
        {
            return Ok(ReadAsset { model, extras: found.extras.clone(), digest });
        }
        let read = read()?;
        if alone {
            let mut cached = self.assets.lock();
            cached.retain(|_, asset| asset.model.strong_count() > 0);
            let model = Arc::downgrade(&read.model);
            cached.insert(digest, CachedAsset { model, extras: read.extras.clone() });
        }
        Ok(read)
    }

    /// Replaces incomplete assets by whole ones, for scenes that are loaded from now on.
    pub fn complete(&self) {
        for asset in self.assets.lock().values_mut() {
            let Some(held) = asset.model.upgrade() else { continue };
            if let Some(whole) = held.deferred.as_ref().and_then(|deferred| deferred.whole.get()) {
                asset.model = Arc::downgrade(whole);
            }
        }
    }
}

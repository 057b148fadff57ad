//! Reader for gltf files.

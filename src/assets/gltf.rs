//! stub
use super::*; use super::input::Input;
pub fn read_from(_i: Input, _o: &ReadOptions) -> Result<Asset, AssetError> { todo!() }

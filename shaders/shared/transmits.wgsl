// Translucent surfaces may let light pass in place of scattering it: what is kept of them tells the channels apart. Other passes draw
// surfaces as if none did.
override TRANSMITS: bool = false;

"""The parts of `scripts/soak.py`: what is true, the clients, the faults, and the fresh renders that frames are compared with."""

"""Controllers as discrete-time blocks: each function returns a `SymbolicBlock` for a `BlockSlave` or for export."""

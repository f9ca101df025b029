"""Hard cases, each compared with a reference: stiffness, singularities, tiny and huge parameters, stiction."""

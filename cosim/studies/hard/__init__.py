"""Hard cases, each judged against a reference: stiffness, singularities, tiny and huge parameters, sticking."""

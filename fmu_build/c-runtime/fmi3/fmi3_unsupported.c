/* Functions for what this FMU doesn't have: variables of other types, clocks but periodic ones, structural parameters. */
#include "instance.h"

#if defined(__GNUC__)
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

// nothing to do for no variables, else an error
static fmi3Status missing(const flex_instance *ours, size_t count, const char *function, const char *what) {
  if (!ours) return fmi3Error;
  return count == 0 ? fmi3OK : flex_log(ours, fmi3Error, LOG_ERROR, "%s is not possible: this FMU has no %s", function, what);
}

#define VARIABLES const fmi3ValueReference valueReferences[], size_t nValueReferences
#define MISSING(function, what, ...)                              \
  fmi3Status function(fmi3Instance instance, VARIABLES, __VA_ARGS__) { \
    return missing(instance, nValueReferences, #function, what);  \
  }
#define MISSING_TYPE(type)                                                                                    \
  MISSING(fmi3Get##type, "variables of type " #type, fmi3##type values[], size_t nValues)                     \
  MISSING(fmi3Set##type, "variables of type " #type, const fmi3##type values[], size_t nValues)

MISSING_TYPE(Float32)
MISSING_TYPE(Int8)
MISSING_TYPE(UInt8)
MISSING_TYPE(Int16)
MISSING_TYPE(UInt16)
MISSING_TYPE(UInt32)
MISSING_TYPE(UInt64)
MISSING_TYPE(Boolean)
MISSING_TYPE(String)
MISSING(fmi3GetBinary, "variables of type Binary", size_t valueSizes[], fmi3Binary values[], size_t nValues)
MISSING(fmi3SetBinary, "variables of type Binary", const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
MISSING(fmi3GetClock, "output clocks", fmi3Clock values[])
MISSING(fmi3GetIntervalDecimal, "clocks whose interval changes", fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
MISSING(fmi3GetIntervalFraction, "clocks whose interval changes", fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
MISSING(fmi3GetShiftDecimal, "clocks whose interval changes", fmi3Float64 shifts[])
MISSING(fmi3GetShiftFraction, "clocks whose interval changes", fmi3UInt64 counters[], fmi3UInt64 resolutions[])
MISSING(fmi3SetIntervalDecimal, "clocks whose interval changes", const fmi3Float64 intervals[])
MISSING(fmi3SetIntervalFraction, "clocks whose interval changes", const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
MISSING(fmi3SetShiftDecimal, "clocks whose interval changes", const fmi3Float64 shifts[])
MISSING(fmi3SetShiftFraction, "clocks whose interval changes", const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])

#define MISSING_MODE(function, what) \
  fmi3Status function(fmi3Instance instance) { return missing(instance, 1, #function, what); }

MISSING_MODE(fmi3EnterConfigurationMode, "structural parameters")
MISSING_MODE(fmi3ExitConfigurationMode, "structural parameters")
MISSING_MODE(fmi3EvaluateDiscreteStates, "such evaluation (providesEvaluateDiscreteStates = false)")

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies) {
  return missing(instance, 1, "fmi3GetNumberOfVariableDependencies",
                 "dependencies of elements (providesPerElementDependencies = false)");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies) {
  return missing(instance, 1, "fmi3GetVariableDependencies",
                 "dependencies of elements (providesPerElementDependencies = false)");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference, fmi3Float64 activationTime) {
  return missing(instance, 1, "fmi3ActivateModelPartition", "model partitions");
}

#if defined(__GNUC__)
#pragma GCC diagnostic pop
#endif

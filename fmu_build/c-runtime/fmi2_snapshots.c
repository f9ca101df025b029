/* Saved states: the numeric state of the plant as it lies in memory, behind a header that says whose it is. */
#include <string.h>

#include "fmi2_instance.h"

typedef struct {
  unsigned long long signature; /* of model and layout */
  unsigned long long size;      /* bytes that follow */
  unsigned long long checksum;  /* of these bytes, once they are serialized */
  unsigned long long unused;    /* keeps what follows aligned for any type */
} flex_snapshot;

// FNV-1a hash (Fowler, Noll, Vo)
static unsigned long long hash_of(const void *bytes, size_t size) {
  const unsigned char *byte = bytes;
  unsigned long long hash = 14695981039346656037ULL;
  for (size_t i = 0; i < size; i++) hash = (hash ^ byte[i]) * 1099511628211ULL;
  return hash;
}

static unsigned long long signature_of(const flex_plant *plant) {
  return hash_of(plant->model->guid, strlen(plant->model->guid)) ^ plant->state_size;
}

static size_t snapshot_size(const flex_plant *plant) {
  return sizeof(flex_snapshot) + plant->state_size;
}

static void *content(flex_snapshot *snapshot) {
  return snapshot + 1;
}

// a snapshot that another model or another version has made would be nonsense here
static int fits(const flex_instance *instance, const flex_snapshot *snapshot) {
  const flex_plant *plant = instance->plant;
  if (snapshot && snapshot->signature == signature_of(plant) && snapshot->size == plant->state_size) return 1;
  flex_log(instance, fmi2Error, LOG_ERROR, "the FMU state does not belong to this FMU, it cannot be used");
  return 0;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2GetFMUstate);
  if (!instance) return fmi2Error;
  if (!FMUstate) return flex_log(instance, fmi2Error, LOG_ERROR, "fmi2GetFMUstate needs a place for the state, got none");

  // an existing one is overwritten
  flex_plant *plant = instance->plant;
  if (*FMUstate && !fits(instance, *FMUstate)) return fmi2Error;
  flex_snapshot *snapshot = *FMUstate ? *FMUstate : flex_allocate(&instance->callbacks, snapshot_size(plant));
  if (!snapshot) return flex_log(instance, fmi2Error, LOG_ERROR, "out of memory for an FMU state");
  snapshot->signature = signature_of(plant);
  snapshot->size = plant->state_size;
  snapshot->checksum = snapshot->unused = 0;
  memcpy(content(snapshot), plant->record, plant->state_size);
  *FMUstate = snapshot;
  return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2SetFMUstate);
  if (!instance || !fits(instance, FMUstate)) return fmi2Error;
  memcpy(instance->plant->record, content(FMUstate), instance->plant->state_size);
  flex_plant_restored(instance->plant);
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2FreeFMUstate);
  if (!instance) return fmi2Error;
  if (!FMUstate || !*FMUstate) return fmi2OK;
  flex_release(&instance->callbacks, *FMUstate);
  *FMUstate = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
  flex_instance *instance = flex_checked(c, call_fmi2SerializedFMUstateSize);
  if (!instance || !fits(instance, FMUstate)) return fmi2Error;
  *size = snapshot_size(instance->plant);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
  flex_instance *instance = flex_checked(c, call_fmi2SerializeFMUstate);
  if (!instance || !fits(instance, FMUstate)) return fmi2Error;
  size_t needed = snapshot_size(instance->plant);
  if (size < needed)
    return flex_log(instance, fmi2Error, LOG_ERROR, "a serialized FMU state needs %lu bytes, got room for %lu",
                    (unsigned long)needed, (unsigned long)size);
  flex_snapshot header = *(flex_snapshot *)FMUstate;
  header.checksum = hash_of(content(FMUstate), instance->plant->state_size);
  memcpy(serializedState, FMUstate, needed);
  memcpy(serializedState, &header, sizeof header);
  return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2DeSerializeFMUstate);
  if (!instance) return fmi2Error;

  // check the header before anything is allocated
  flex_snapshot header = {0, 0, 0, 0};
  size_t needed = snapshot_size(instance->plant);
  if (size >= sizeof header) memcpy(&header, serializedState, sizeof header);
  if (!fits(instance, &header)) return fmi2Error;
  if (size < needed)
    return flex_log(instance, fmi2Error, LOG_ERROR, "a serialized FMU state has %lu bytes, got %lu", (unsigned long)needed,
                    (unsigned long)size);
  if (hash_of(serializedState + sizeof header, instance->plant->state_size) != header.checksum)
    return flex_log(instance, fmi2Error, LOG_ERROR, "the serialized FMU state has been changed, its checksum is wrong");
  flex_snapshot *snapshot = flex_allocate(&instance->callbacks, needed);
  if (!snapshot) return flex_log(instance, fmi2Error, LOG_ERROR, "out of memory for an FMU state");
  memcpy(snapshot, serializedState, needed);
  *FMUstate = snapshot;
  return fmi2OK;
}

/* Saved states: the numeric state as it lies in memory, behind a header that says whose it is. */
#include <string.h>

#include "instance.h"

typedef struct flex_snapshot {
  unsigned long long signature; /* of model and layout; 0 once it is freed */
  unsigned long long size;      /* of the numeric state, which follows this header */
  unsigned long long checksum;  /* of session and numeric state, once they are serialized */
  flex_session session;
  struct flex_snapshot *next_freed; /* never serialized */
} flex_snapshot;

// FNV-1a hash (Fowler, Noll, Vo)
static unsigned long long hash_of(const void *bytes, size_t size) {
  const unsigned char *byte = bytes;
  unsigned long long hash = 14695981039346656037ULL;
  for (size_t i = 0; i < size; i++) hash = (hash ^ byte[i]) * 1099511628211ULL;
  return hash;
}

static unsigned long long checksum_of(const void *snapshot, size_t size) {
  size_t begin = offsetof(flex_snapshot, session);
  return hash_of((const char *)snapshot + begin, size - begin);
}

static unsigned long long signature_of(const flex_backend *backend) {
  return hash_of(flex_backend_guid(), strlen(flex_backend_guid())) ^ backend->state_size;
}

static size_t snapshot_size(const flex_backend *backend) {
  return sizeof(flex_snapshot) + backend->state_size;
}

static void *content(flex_snapshot *snapshot) {
  return snapshot + 1;
}

// a snapshot that another model or another version has made would be nonsense here
static int fits(const flex_instance *instance, const flex_snapshot *snapshot) {
  const flex_backend *backend = instance->backend;
  int is_ours = snapshot && snapshot->signature == signature_of(backend) && snapshot->size == backend->state_size;
  if (is_ours && snapshot->session.kind == instance->session.kind) return 1;
  if (is_ours)
    flex_log(instance, fmi2Error, LOG_ERROR, "the FMU state belongs to an instance for %s, this one is for %s",
             snapshot->session.kind == EXCHANGE ? "model exchange" : "co-simulation",
             instance->session.kind == EXCHANGE ? "model exchange" : "co-simulation");
  else
    flex_log(instance, fmi2Error, LOG_ERROR,
             "the FMU state does not belong to this FMU or has been freed, it cannot be used");
  return 0;
}

// memory for a state: that of a freed one if there is any
static flex_snapshot *take_snapshot(flex_instance *instance) {
  flex_snapshot *snapshot = instance->freed_states;
  if (snapshot)
    instance->freed_states = snapshot->next_freed;
  else
    snapshot = flex_allocate(&instance->callbacks, snapshot_size(instance->backend));
  if (!snapshot) flex_log(instance, fmi2Error, LOG_ERROR, "out of memory for an FMU state");
  return snapshot;
}

void flex_release_states(flex_instance *instance) {
  while (instance->freed_states) {
    flex_snapshot *snapshot = instance->freed_states;
    instance->freed_states = snapshot->next_freed;
    flex_release(&instance->callbacks, snapshot);
  }
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2GetFMUstate);
  if (!instance || flex_lacks(instance, call_fmi2GetFMUstate, "a place for the state", FMUstate, 1)) return fmi2Error;

  // an existing one is overwritten
  flex_backend *backend = instance->backend;
  if (*FMUstate && !fits(instance, *FMUstate)) return fmi2Error;
  flex_snapshot *snapshot = *FMUstate ? *FMUstate : take_snapshot(instance);
  if (!snapshot) return fmi2Error;
  snapshot->signature = signature_of(backend);
  snapshot->size = backend->state_size;
  snapshot->checksum = 0;
  snapshot->session = instance->session;
  snapshot->next_freed = NULL;
  memcpy(content(snapshot), backend->state, backend->state_size);
  *FMUstate = snapshot;
  return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2SetFMUstate);
  if (!instance || !fits(instance, FMUstate)) return fmi2Error;
  instance->session = ((const flex_snapshot *)FMUstate)->session;
  memcpy(instance->backend->state, content(FMUstate), instance->backend->state_size);
  instance->reason[0] = '\0';
  flex_backend_restored(instance->backend);
  return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2FreeFMUstate);
  if (!instance) return fmi2Error;
  if (!FMUstate || !*FMUstate) return fmi2OK;
  if (!fits(instance, *FMUstate)) return fmi2Error;

  // kept, so that it is known if it is freed again, and that the next one needs no new memory
  flex_snapshot *snapshot = *FMUstate;
  snapshot->signature = 0;
  snapshot->next_freed = instance->freed_states;
  instance->freed_states = snapshot;
  *FMUstate = NULL;
  return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size) {
  flex_instance *instance = flex_checked(c, call_fmi2SerializedFMUstateSize);
  if (!instance || !fits(instance, FMUstate)) return fmi2Error;
  if (flex_lacks(instance, call_fmi2SerializedFMUstateSize, "a place for the size", size, 1)) return fmi2Error;
  *size = snapshot_size(instance->backend);
  return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size) {
  flex_instance *instance = flex_checked(c, call_fmi2SerializeFMUstate);
  if (!instance || !fits(instance, FMUstate)) return fmi2Error;
  size_t needed = snapshot_size(instance->backend);
  if (flex_lacks(instance, call_fmi2SerializeFMUstate, "a place for the bytes", serializedState, 1)) return fmi2Error;
  if (size < needed)
    return flex_log(instance, fmi2Error, LOG_ERROR, "a serialized FMU state needs %lu bytes, got room for %lu",
                    (unsigned long)needed, (unsigned long)size);
  flex_snapshot header = *(flex_snapshot *)FMUstate;
  header.checksum = checksum_of(FMUstate, needed);
  memcpy(serializedState, FMUstate, needed);
  memcpy(serializedState, &header, sizeof header);
  return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size, fmi2FMUstate *FMUstate) {
  flex_instance *instance = flex_checked(c, call_fmi2DeSerializeFMUstate);
  if (!instance || flex_lacks(instance, call_fmi2DeSerializeFMUstate, "bytes", serializedState, 1) ||
      flex_lacks(instance, call_fmi2DeSerializeFMUstate, "a place for the state", FMUstate, 1))
    return fmi2Error;

  // check the header before anything is allocated
  flex_snapshot header;
  memset(&header, 0, sizeof header);
  size_t needed = snapshot_size(instance->backend);
  if (size >= sizeof header) memcpy(&header, serializedState, sizeof header);
  if (!fits(instance, &header)) return fmi2Error;
  if (size != needed)
    return flex_log(instance, fmi2Error, LOG_ERROR, "a serialized FMU state has %lu bytes, got %lu", (unsigned long)needed,
                    (unsigned long)size);
  if (checksum_of(serializedState, needed) != header.checksum)
    return flex_log(instance, fmi2Error, LOG_ERROR, "the serialized FMU state has been changed, its checksum is wrong");
  flex_snapshot *snapshot = take_snapshot(instance);
  if (!snapshot) return fmi2Error;
  memcpy(snapshot, serializedState, needed);
  *FMUstate = snapshot;
  return fmi2OK;
}

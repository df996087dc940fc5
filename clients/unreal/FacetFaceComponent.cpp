#include "FacetFaceComponent.h"

#include "Components/SkeletalMeshComponent.h"
#include "GameFramework/Actor.h"
#include "ProceduralMeshComponent.h"

UFacetFaceComponent::UFacetFaceComponent() {
  PrimaryComponentTick.bCanEverTick = true;
}

void UFacetFaceComponent::BeginPlay() {
  Super::BeginPlay();
  Mesh = NewObject<UProceduralMeshComponent>(GetOwner());
  Mesh->AttachToComponent(GetOwner()->GetRootComponent(), FAttachmentTransformRules::KeepRelativeTransform);
  Mesh->RegisterComponent();
  Reader = MakeUnique<facet_unreal::FacetReader>(std::string(TCHAR_TO_UTF8(*Socket)));
}

void UFacetFaceComponent::EndPlay(const EEndPlayReason::Type Reason) {
  Reader.Reset();
  Super::EndPlay(Reason);
}

void UFacetFaceComponent::TickComponent(float DeltaTime, ELevelTick TickType,
                                        FActorComponentTickFunction* ThisTick) {
  Super::TickComponent(DeltaTime, TickType, ThisTick);
  if (!Reader || !Reader->poll()) {
    return;
  }
  const facet_unreal::Face& Face = Reader->face();
  const int32 Count = static_cast<int32>(Face.vertices_cm.size() / 3);
  const auto Point = [](const std::vector<float>& From, int32 K) {
    return FVector(From[3 * K], From[3 * K + 1], From[3 * K + 2]);
  };
  TArray<FVector> Vertices, Normals;
  TArray<FVector2D> Coordinates;
  TArray<FLinearColor> Colours;
  Vertices.Reserve(Count);
  Normals.Reserve(Count);
  for (int32 K = 0; K < Count; ++K) {
    Vertices.Add(Point(Face.vertices_cm, K));
    Normals.Add(Point(Face.normals, K));
    Coordinates.Add(FVector2D(Face.texture_coordinates[2 * K], Face.texture_coordinates[2 * K + 1]));
    if (!Face.linear_rgb.empty()) {
      Colours.Add(
          FLinearColor(Face.linear_rgb[3 * K], Face.linear_rgb[3 * K + 1], Face.linear_rgb[3 * K + 2]));
    }
  }
  if (Face.subject_id != SubjectShown) {
    TArray<int32> Triangles(Face.triangles.data(), static_cast<int32>(Face.triangles.size()));
    Mesh->CreateMeshSection_LinearColor(0, Vertices, Triangles, Normals, Coordinates, Colours,
                                        TArray<FProcMeshTangent>(), false);
    SubjectShown = Face.subject_id;
  } else {
    Mesh->UpdateMeshSection_LinearColor(0, Vertices, Normals, Coordinates, Colours,
                                        TArray<FProcMeshTangent>());
  }
  const auto& Turn = Face.turn;
  const auto Axis = [&Turn](int32 K) { return FVector(Turn[0][K], Turn[1][K], Turn[2][K]); };
  Mesh->SetRelativeRotation(FMatrix(Axis(0), Axis(1), Axis(2), FVector::ZeroVector).ToQuat());
  for (size_t K = 0; Rig != nullptr && K < Face.avatar_values.size(); ++K) {
    Rig->SetMorphTarget(FName(UTF8_TO_TCHAR(Face.expression_names[K].c_str())), Face.avatar_values[K]);
  }
}

// A live face on an actor with a UProceduralMeshComponent, on Linux (libfacet-client reads a Unix socket).
// Put the four files into Source/YOURMODULE, and into YOURMODULE.Build.cs:
//   PublicDependencyModuleNames.Add("ProceduralMeshComponent");
//   PublicSystemLibraries.Add("facet-client");
#pragma once

#include "Components/ActorComponent.h"
#include "CoreMinimal.h"
#include "FacetReader.h"
// Unreal wants its own last.
#include "FacetFaceComponent.generated.h"  // IWYU pragma: keep

class UProceduralMeshComponent;
class USkeletalMeshComponent;

UCLASS(ClassGroup = (Facet), meta = (BlueprintSpawnableComponent))
class UFacetFaceComponent : public UActorComponent {
  GENERATED_BODY()

 public:
  UFacetFaceComponent();

  /// Where facetd listens; empty: /run/facet/stream.sock.
  UPROPERTY(EditAnywhere, Category = "Facet")
  FString Socket;

  /// A second rig with ARKit's morph targets that the expression drives; may be empty.
  UPROPERTY(EditAnywhere, Category = "Facet")
  USkeletalMeshComponent* Rig = nullptr;

  virtual void BeginPlay() override;
  virtual void EndPlay(const EEndPlayReason::Type Reason) override;
  virtual void TickComponent(float DeltaTime, ELevelTick TickType,
                             FActorComponentTickFunction* ThisTick) override;

 private:
  TUniquePtr<facet_unreal::FacetReader> Reader;
  UPROPERTY()
  UProceduralMeshComponent* Mesh = nullptr;
  uint64 SubjectShown = 0;
};
